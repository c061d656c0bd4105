"""ELFIN-A: what is recovered from a simulated spinner of the same kind, and what is found in the flight record.

Flight data: ELFIN-A of 2022-01-12 (github jiashuwu89/elf_fgm, fbaba5dd); see flight/README.md in the shared folder, whose
figures come from an independent look at the same file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.elfin import record, sensor, study
from fluxtwin.scenarios.elfin.study import refusal
from fluxtwin.scenarios.elfin.zone_fit import fit_zone, local_noise_nT, spin_rate
from fluxtwin.scenarios.recorded_files import Settings, check_folder, read_settings
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.closure

Close = Callable[..., None]
SETTINGS = read_settings(study.SETTINGS)
NOISE_NT = 3.0
MATRIX = np.array([[0.38, 0.05, 0.95], [0.75, 0.15, -0.55], [0.02, 1.12, 0.03]])
OFFSET_NT = np.array([-600.0, -300.0, 200.0])
TURN_RAD = np.array([[0.1, -0.4, 0.0], [-0.2, 0.6, 0.0]])
SCALE = np.array([[0.3, -0.1, 0.05], [-0.4, 0.2, 0.02]])
LAGS_S = ((200.0,), (400.0,))


def a_day() -> record.Day:
    """Orbits of 5580 s, of which 640 s are dark."""
    seconds = np.arange(0.0, 86400.0, 10.0)
    return record.Day(seconds, (seconds % 5580.0 > 640.0).astype(float))


def a_zone(number: int, begin_s: float, turned: bool, settings: Settings = SETTINGS) -> record.Zone:
    """Six minutes of a spinner whose boom and scale follow the day's light, or not; noise of 3 nT."""
    rng = np.random.default_rng(number)
    seconds = begin_s + np.arange(0.0, 370.0, 0.1)
    share = (seconds - seconds.mean()) / (seconds[-1] - seconds.mean())
    along = 1000.0 + 400.0 * number + 600.0 * share
    azimuth = 0.3 * number + 0.6 * share
    field = np.stack([45000.0 * np.cos(azimuth), 45000.0 * np.sin(azimuth), along], axis=1)
    phase = 2.0 * np.pi / 2.85 * (seconds - seconds.mean()) + 0.7 * number + 0.02 * share**2
    body = Rotation.from_rotvec(np.outer(-phase, [0.0, 0.0, 1.0])).apply(field)
    states = np.stack([a_day().lagged(seconds, *lags) for lags in LAGS_S], axis=1)
    gain = np.ones_like(body)
    if turned:
        body = Rotation.from_rotvec(-states @ TURN_RAD).apply(body)
        gain = 1.0 + states @ SCALE
    reading = (body @ MATRIX.T) * gain + OFFSET_NT + NOISE_NT * rng.standard_normal(body.shape)
    stamps = epoch.add_seconds(np.datetime64("2022-01-12T00:00:00", "ns"), seconds)
    none, frame = np.zeros(seconds.size), np.tile(np.eye(3), (seconds.size, 1, 1))
    used, left_out = record.usable(seconds, (), settings)
    return record.Zone(number, Telemetry(stamps, reading), seconds, frame, field, none, (), used, left_out)


def a_flight(turned: bool) -> record.Flight:
    begins = [5580.0 * orbit + after for orbit, after in ((1, 180.0), (2, 300.0), (4, 240.0), (6, 350.0), (7, 700.0))]
    zones = tuple(a_zone(number, begin, turned) for number, begin in enumerate(begins))
    return record.Flight(zones, a_day(), 0.004)


def without_states(one: sensor.Sensor) -> sensor.Sensor:
    """The same sensor that follows nothing."""
    none = np.zeros_like(one.turn_rad)
    return replace(one, turn_rad=none, scale=none, bias_knT=none)


def test_a_static_sensor_is_found_with_its_phase(close: Close) -> None:
    """A still sensor leaves the noise: sqrt(3) times 3 nT; the drift of the rate is in the phase, not in the sensor."""
    zone = a_zone(2, 12000.0, turned=False)
    rate = spin_rate(zone, SETTINGS)
    fit = fit_zone(zone, "static", SETTINGS, rate)
    close(
        2.0 * np.pi / fit.rate_rad_s, 2.85, atol=1e-5, unit="s", because="a turn in 370 s to a thousandth of a degree"
    )
    close(fit.rms_nT, NOISE_NT * np.sqrt(3.0), atol=0.15, unit="nT", because="11,000 components: 1 %, three of them")
    across = np.linalg.norm(fit.coefficients[:2], axis=0)
    close(across, np.linalg.norm(MATRIX[:, :2], axis=1), atol=1e-4, unit="1", because="3 nT of 45,000 over 3,700 rows")
    close(local_noise_nT(zone, fit), NOISE_NT * np.sqrt(3.0), atol=0.3, unit="nT", because="the median of 32 stretches")
    assert np.abs(across - 1.01 * np.linalg.norm(MATRIX[:, :2], axis=1)).max() > 1e-3


def test_a_bending_boom_is_found_and_predicts_an_unseen_zone(close: Close) -> None:
    """Five zones with a boom and scale that follow the light: from four of them the fifth is predicted to the noise."""
    flight = a_flight(turned=True)
    own = [fit_zone(zone, "static", SETTINGS) for zone in flight.zones]
    rows = sensor.rows_of(flight, own, LAGS_S, 15)
    joint = sensor.fit_joint(rows, sensor.start(own, 2, 2), ("turn", "scale"))
    close(joint.whole_nT, NOISE_NT * np.sqrt(3.0), atol=1.0, unit="nT", because="nothing but noise is left")
    begin = (joint.sensor, joint.phases[1:])
    rest = sensor.fit_joint(rows[1:], begin, ("turn", "scale"))
    seen = sensor.seen_by(rest.sensor, rows[0], joint.phases[0])
    static = sensor.fit_joint(rows[1:], (without_states(joint.sensor), joint.phases[1:]), ())
    blind = sensor.seen_by(static.sensor, rows[0], joint.phases[0])
    assert seen.rms_nT[0] < 0.1 * blind.rms_nT[0]
    # The wrong lags, and a boom alone, do not do.
    other = sensor.rows_of(flight, own, ((60.0,),), 15)
    wrong = sensor.fit_joint(other, sensor.start(own, 1, 2), ("turn", "scale"))
    alone = sensor.fit_joint(rows, sensor.start(own, 2, 2), ("turn",))
    assert min(wrong.whole_nT, alone.whole_nT) > 5.0 * joint.whole_nT


def test_a_still_sensor_gains_nothing_from_sun_and_shadow(close: Close) -> None:
    flight = a_flight(turned=False)
    own = [fit_zone(zone, "static", SETTINGS) for zone in flight.zones]
    rows = sensor.rows_of(flight, own, LAGS_S, 15)
    static = sensor.fit_joint(rows, sensor.start(own, 2, 2), ())
    joint = sensor.fit_joint(rows, sensor.start(own, 2, 2), ("turn", "scale"))
    close(static.whole_nT, joint.whole_nT, atol=0.1, unit="nT", because="12 parameters more among 3,600 numbers")
    close(static.whole_nT, NOISE_NT * np.sqrt(3.0), atol=0.3, unit="nT", because="the noise put in")


def test_the_turn_is_that_of_the_effect() -> None:
    """`boom_bending` turns the sensor by +, so the field in it by -, right-handed; so does this model."""
    zone = a_zone(0, 6000.0, turned=False)
    fit = fit_zone(zone, "static", SETTINGS)
    (one,) = sensor.rows_of(record.Flight((zone,), a_day(), 0.004), [fit], ((200.0,),), 50)
    bent = sensor.Sensor(np.eye(3), np.zeros(3), np.array([[0.0, 0.0, 0.2]]), np.zeros((1, 3)), np.zeros((1, 3)))
    straight = without_states(bent).in_body_nT(one, np.zeros(3))
    a = 0.2 * one.states[:, 0]
    x = straight[:, 0] * np.cos(a) + straight[:, 1] * np.sin(a)
    np.testing.assert_allclose(bent.in_body_nT(one, np.zeros(3))[:, 0], x, atol=1e-6)


def test_slips_are_named_by_the_stamps() -> None:
    """A packet that is stamped late; one irregular step alone; a packet that is missing is no slip."""
    seconds = np.arange(400) * 0.1
    seconds[50:75] += 0.0088
    seconds[200:] += 0.0125
    seconds[300:] += 2.5
    first, second = record.clock_slips(seconds, 25)
    assert (first.first, first.last, round(first.late_s, 4)) == (50, 74, 0.0088)
    assert (second.first, second.last, round(second.late_s, 4)) == (175, 199, -0.0125)
    assert record.clock_slips(np.arange(400) * 0.1, 25) == ()


def test_a_folder_without_the_files_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"missing there: elfin_a_20220112\.nc, elfin_a_20220112_state\.nc"):
        check_folder(tmp_path, SETTINGS.files)


@pytest.fixture(scope="module")
def flight(shared: Path) -> record.Flight:
    if not all((shared / "flight" / name).is_file() for name in SETTINGS.files):
        pytest.skip("ELFIN-A's files are absent")
    return record.read_flight(shared / "flight", SETTINGS, load_field(SETTINGS.field_model))


def test_zones_slips_and_noise_of_the_flight(flight: record.Flight) -> None:
    """Nine zones; slips of 6 to 12.5 ms (the source: about 1/80 s); local noise 5.5 to 6.8 nT by the independent look,
    which had no fifth harmonic: ours may be up to a fifth smaller, not larger."""
    assert [zone.number for zone in flight.zones] == list(range(9))
    late_ms = [1e3 * abs(slip.late_s) for zone in flight.zones for slip in zone.slips]
    assert len(late_ms) == 12 and min(late_ms) > 6.0 and max(late_ms) < 12.6
    for place in (0, 8):
        zone = flight.zones[place]
        fit = fit_zone(zone, "static", SETTINGS)
        assert 2.84 < 2.0 * np.pi / fit.rate_rad_s < 2.89  # the README: 2.84 to 2.88 s
        low, high = SETTINGS.printed.noise_nT
        assert 0.8 * low < local_noise_nT(zone, fit) < high
        kinds = [fit_zone(zone, kind, SETTINGS, fit.rate_rad_s).rms_nT for kind in ("linear", "quadratic")]
        assert kinds[1] < kinds[0] < 0.5 * fit.rms_nT  # a static sensor it is not
        assert refusal(zone, load_field(SETTINGS.field_model))


def test_what_follows_sun_and_shadow_predicts_unseen_zones(flight: record.Flight) -> None:
    """The reach: below half of the static sensor's rms on zones that were not used, over all nine; the boom alone in
    the zones in shadow. The spin phase is the only thing that an unseen zone gives."""
    own = [fit_zone(zone, "static", SETTINGS) for zone in flight.zones]
    coarse = Settings(SETTINGS.tree | {"every": 23, "settle_s": [300.0], "pairs_s": [[300.0, 500.0]]})
    static, _, boom, scaled = sensor.compare(flight, own, coarse)
    assert scaled.unseen_whole_nT < 0.5 * static.unseen_whole_nT
    dark = slice(0, 7)
    assert np.median(np.array(boom.unseen_nT[dark]) / np.array(static.unseen_nT[dark])) < 0.5
    noise = max(local_noise_nT(zone, fit) for zone, fit in zip(flight.zones, own, strict=True))
    assert min(scaled.unseen_nT) > noise
    assert study.words().say("lags", lags_s=scaled.lags_s) == "300; 500"
