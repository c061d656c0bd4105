"""Real flight data of 1978, packaged with the product: never skipped.

Witness: Table 5 of Lerner & Shuster (AIAA 79-1695), 43 station passes of HCMM. The orbit is fitted to acquisition times
and sun-nadir angles; the sun-field angles, which entered nothing, are then predicted. This tests earth rotation,
precession, orbit, sun and main field together. The bars are half a degree and a little: print is whole degrees, and an
independent program reached 0.53 deg (as scanned) and 0.49 deg (corrected digits) by the same method.
"""

from __future__ import annotations

import csv
import dataclasses
from importlib import resources

import numpy as np
import pytest

from fluxtwin.scenarios.hcmm.mission import read_table
from fluxtwin.scenarios.hcmm_orbit.fit import fit_orbit
from fluxtwin.scenarios.hcmm_orbit.predictions import DIPOLE, MAIN_FIELD, run_flight_test, weigh_ideas, windows_of
from fluxtwin.scenarios.hcmm_orbit.record import read_passes, read_stations
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.scenario.scenario import load_scenario

pytestmark = pytest.mark.reference


@pytest.fixture(scope="module")
def fit():
    return fit_orbit()


@pytest.fixture(scope="module")
def flight(fit):
    return run_flight_test(fit)


def _table(shared):
    return list(csv.DictReader((shared / "reference/papers/hcmm_passes.csv").read_text(encoding="utf-8").splitlines()))


def test_sun_field_angles_of_24_real_passes_are_predicted(flight):
    assert flight.error_deg.shape == (24, 2)
    assert flight.median_as_scanned_deg <= 0.65
    assert flight.median_deg <= 0.60
    # The prototype: 40 of 48 ends within 1 deg, 37 with the digits of the scan.
    assert flight.within_1_deg >= 40
    assert flight.within_1_deg_as_scanned >= 37


def test_the_same_test_fails_when_one_thing_is_wrong(flight):
    """The mutants of this test: what it must be able to tell, by how many times the median error must grow."""
    grown = {name: value / flight.median_deg for name, value in flight.nulls_deg.items()}
    assert grown["dipole"] >= 3.0
    assert grown["degree2"] >= 2.0
    assert grown["field_10deg"] >= 2.0
    assert grown["node_15min"] >= 1.7
    assert grown["degree4"] > 1.0


def test_a_swapped_sign_of_the_field_is_seen(fit):
    model = load_field("igrf14")
    flipped = dataclasses.replace(model, polynomial_nT=-model.polynomial_nT, static_nT=-model.static_nT)
    assert run_flight_test(fit, flipped).median_deg > 20.0


def test_orbit_agrees_with_an_independent_fit_of_the_same_record(fit, close):
    """Another program, another loss (L1), sun-field angles used as well: 6996-6997 km, 271.6 deg, 53-54 deg."""
    a, node, u = fit.values
    close(a, 6996.6, atol=1.2, unit="km", because="the other fits give 6996.1 and 6997.2; our sigma is 0.25")
    close(node, 271.6, atol=0.4, unit="deg", because="our sigma is 0.20, theirs unknown")
    close(u, 53.4, atol=1.3, unit="deg", because="the other fits give 53.0 and 53.9; our sigma is 0.45")
    close(fit.orbit.nodal_period_s / 60, 97.18, atol=0.05, unit="min", because="follows from a")
    assert (fit.sigmas > [0.05, 0.03, 0.1]).all()
    assert (fit.sigmas < [1.0, 0.5, 1.5]).all()
    assert (np.linalg.eigvalsh(fit.covariance) > 0).all()


def test_no_sun_field_and_no_nadir_field_angle_enters_the_orbit(fit):
    misread = tuple(
        dataclasses.replace(p, sun_field=p.sun_field and (0.0, 1.0), nadir_field_read=(0.0, 1.0)) for p in read_passes()
    )
    assert (fit_orbit(misread).values == fit.values).all()


def test_the_fit_needs_no_starting_value_and_finds_every_pass(fit):
    assert (fit.highest_deg > 9.0).all()  # the lowest pass of the independent fit stands at 10 deg
    # Whole minutes, masks, routine: the independent fit has 0.98 min rms.
    assert np.sqrt(np.mean(fit.rise_min**2)) < 1.2
    assert np.abs(fit.rise_min).max() < 3.5


def test_the_fit_is_the_same_from_wherever_it_starts(monkeypatch, fit):
    """Windows beside a turning point have several places; a fit that took the nearest went 0.1 to 0.4 deg astray."""
    from fluxtwin.scenarios.hcmm_orbit import fit as module

    for away in ([0.3, -0.2, 0.5], [2.6, 1.4, -1.0]):
        monkeypatch.setattr(module, "first_guess", lambda passes, away=away: tuple(fit.values + away))
        assert (np.abs(fit_orbit().values - fit.values) < 0.02 * fit.sigmas).all()


def test_greatest_elevations_against_the_independent_fit(shared, fit, close):
    theirs = np.array([float(row["fit_maxel"]) for row in _table(shared)])
    # Half a degree of node moves a high pass by several degrees; most stand low.
    close(
        np.median(np.abs(fit.highest_deg - theirs)), 0.0, atol=1.0, unit="deg", because="printed to 1 deg, other node"
    )


def test_free_inclination_is_the_public_one_within_its_sigma(close):
    free = fit_orbit(free_inclination=True)
    assert abs(free.values[3] - 97.6) < 2.5 * free.sigmas[3]
    assert free.sigmas[3] < 1.5


def test_the_record_is_the_table_with_the_documented_changes_only(shared):
    theirs = _table(shared)
    ours = read_passes()
    assert len(ours) == len(theirs) == 43
    for mine, row in zip(ours, theirs, strict=True):
        assert mine.aos_read == row["aos_read"]
        assert [f"{v:.0f}" for v in mine.sun_nadir_read] == [row["se_lo_read"], row["se_hi_read"]]
        assert [f"{v:.0f}" for v in mine.nadir_field_read] == [row["em_lo_read"], row["em_hi_read"]]
        read = [] if mine.sun_field_read is None else [f"{v:.0f}" for v in mine.sun_field_read]
        assert read == [v for v in (row["sm_lo_read"], row["sm_hi_read"]) if v]


def test_seven_acquisition_times_and_four_sun_field_digits_are_changed():
    passes = read_passes()
    hhmm = {p.number: str(p.aos)[11:13] + str(p.aos)[14:16] for p in passes}
    changed = {p.aos_read: hhmm[p.number] for p in passes if p.aos_read != hhmm[p.number]}
    assert changed == {
        "0067": "0057",
        "1584": "1554",
        "1615": "1815",
        "1619": "1819",
        "0821": "0921",
        "1089": "1059",
        "1637": "1837",
    }
    assert sum(p.sun_field != p.sun_field_read for p in passes) == 4
    # No sunlit pass has a changed sun-nadir range, so both forms of the test use the same windows.
    assert not [p.number for p in passes if p.sunlit and p.sun_nadir != p.sun_nadir_read]
    assert all(p.why for p in passes if p.sun_nadir != p.sun_nadir_read or p.sun_field != p.sun_field_read)


def test_the_scenario_of_the_study_flies_the_fitted_orbit(fit):
    path = resources.files("fluxtwin.scenarios.hcmm").joinpath("hcmm.toml")
    orbit = load_scenario(str(path)).orbit
    found = [orbit.altitude_km + 6378.137, orbit.raan_deg, orbit.argument_of_latitude_deg]
    assert (np.abs(np.array(found) - fit.values) <= 0.006).all()  # the file holds two decimals
    assert orbit.inclination_deg == 97.6


def test_goldstone_is_where_deep_space_station_16_stood(close):
    """ITRF coordinates of DSS 16, the STDN's 26 m antenna at Goldstone (JPL list of 2008), converted."""
    dss_16_km = np.array([-2354.7633158, -4646.7874130, 3669.3869959])
    station = read_stations()["GDS"]
    latitude, longitude, _ = frames.geodetic(dss_16_km[None, :])
    close(np.degrees(latitude[0]), np.degrees(station.latitude_rad), atol=0.001, unit="deg", because="100 m")
    close(np.degrees(longitude[0]) % 360, np.degrees(station.longitude_rad), atol=0.001, unit="deg", because="100 m")


@pytest.mark.parametrize(
    ("station", "latitude_deg", "longitude_deg", "height_km", "within_km"),
    [
        ("ORR", -35.62789, 148.95702, 0.952, 0.05),
        ("MIL", 28.50812, 279.30660, -0.026, 0.05),
        ("ULA", 64.97214, 212.48661, 0.344, 0.05),
        ("MAD", 40.45545, 355.83162, 0.838, 0.2),
        ("ETC", 38.99845, 283.15723, 0.018, 0.05),
    ],
)
def test_five_stations_are_where_nasa_s_directory_has_them(
    close, station, latitude_deg, longitude_deg, height_km, within_km
):
    """ORR3, MIL3, ULA3, MAD8 and BLTD (Goddard) of the directory of station locations (NAIF, ndosl_190716_v02.tf)."""
    there = frames.from_geodetic(*(np.array([v]) for v in (*np.radians([latitude_deg, longitude_deg]), height_km)))
    away = np.linalg.norm(read_stations()[station].r_E_km - there.reshape(3))
    close(away, 0.0, atol=within_km, unit="km", because="four decimals here; at Madrid another antenna of the site")


def test_the_minutes_of_table_6_agree_with_winkfield():
    """Table 6 of the conference paper, as scanned: whole minutes of arc, most of its 28 numbers damaged.

    A wrong number of minutes agrees within one by chance once in 30 times; eight of 14 do, and both of Winkfield's.
    """
    agree = {}
    for row in read_table("yaw"):
        place = read_stations()[row["station"]]
        for name, angle in (("lat", abs(place.latitude_rad)), ("elon", place.longitude_rad)):
            printed = int(row[f"{name}_read"].split()[1].strip("'"))
            away = (np.degrees(angle) * 60.0 - printed + 30.0) % 60.0 - 30.0
            agree[row["station"], name] = abs(away) <= 1.0
    assert sum(agree.values()) >= 8
    assert agree["WNK", "lat"]
    assert agree["WNK", "elon"]


def test_a_tenth_of_a_degree_at_the_stations_does_not_matter(monkeypatch, fit, flight):
    """Winkfield's was found in whole minutes of arc only; 0.1 deg is 11 km, two seconds of a rise."""
    from fluxtwin.scenarios.hcmm_orbit import fit as fitting
    from fluxtwin.scenarios.hcmm_orbit import geometry

    rng = np.random.default_rng(3)
    moved = {
        name: dataclasses.replace(
            station,
            latitude_rad=station.latitude_rad + np.radians(0.1) * rng.choice([-1, 1]),
            longitude_rad=station.longitude_rad + np.radians(0.1) * rng.choice([-1, 1]),
        )
        for name, station in read_stations().items()
    }
    for module in (geometry, fitting):
        monkeypatch.setattr(module, "read_stations", lambda: moved)
    other = fit_orbit()
    assert (np.abs(other.values - fit.values) < 1.5 * fit.sigmas).all()
    assert abs(run_flight_test(other).median_deg - flight.median_deg) < 0.1


def test_the_nadir_field_column_is_an_open_question_with_these_facts(fit, close):
    """Reported, never gated on: what the main field leaves unexplained, and that a dipole does better there."""
    windows = windows_of(read_passes(), fit.orbit, as_scanned=False)
    found = weigh_ideas(fit, windows)
    ideas = {idea.name: idea for idea in found.ideas}
    main, dipole = ideas[MAIN_FIELD], ideas[DIPOLE]
    # The independent program: 4.2 deg for the main field, 2.05 deg for a dipole, over the sunlit ends.
    close(main.groups["poleward, sunlit"].median_deg, 4.2, atol=0.6, unit="deg", because="one of two groups")
    assert dipole.explained > 1.5 * main.explained
    # Dealt out at random the ranges fit the main field nearly as well, the dipole far less (sd about 2.5 ends).
    assert dipole.explained - dipole.by_chance[0] > 4 * dipole.by_chance[1]
    assert main.explained - main.by_chance[0] < 4 * main.by_chance[1]
    close(found.model_pole_deg, (78.8, 289.3), atol=0.2, unit="deg", because="published pole of the dipole, 1978")
