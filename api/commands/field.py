"""`fluxtwin field`: the field at one place and time."""

from __future__ import annotations

from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Print the geomagnetic field at one place and time."


def command(
    output: Output,
    date: Annotated[str, of.option("UTC", "ISO 8601, as 1978-07-24 or 1978-07-24T06:00:00Z.")],
    lat: Annotated[float, of.option("DEG", "Geodetic latitude (WGS 84) [deg].")],
    lon: Annotated[float, of.option("DEG", "East longitude [deg].")],
    alt_km: Annotated[float, of.option("KM", "Height above the ellipsoid [km].")] = 0.0,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
) -> None:
    """The field at a geodetic point (WGS 84).

    Geodetic north, east, down and total field [nT], declination and inclination [deg].
    """
    with output.progress("evaluating the field"):
        from fluxtwin import verbs

        output.claim({}, [field])
        record = verbs.field(date, lat, lon, alt_km, field=field, degree=degree)
    names = ("north_nT", "east_nT", "down_nT", "horizontal_nT", "F_nT")
    output.say(f"{record['field_model']}, degree {record['degree']}")
    output.say(f"{record['date']}  latitude {lat:g} deg  longitude {lon:g} deg  height {alt_km:g} km")
    for name in names:
        output.say(f"{name[:-3]:<12}{record[name]:>12.1f} nT")
    for name in ("declination_deg", "inclination_deg"):
        value = record[name]
        output.say(f"{name[:-4]:<12}{'undefined' if value is None else f'{value:.3f}':>12} deg")
    output.result(record)
