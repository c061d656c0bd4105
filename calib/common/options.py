"""The options of calibration methods, each declared once: its type, its help, what is allowed.

The options of a method are a dataclass whose fields carry these as metadata. The command line, the signature of
`fluxtwin.calibrate` and the refusal of what a method does not take follow from the dataclasses. `--help` reads this module,
so it imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress, silent

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.sim.earth.field import FieldModel
    from fluxtwin.sim.telemetry.record import Telemetry


@dataclass(frozen=True)
class Option:
    """One option. Called, it is the metadata of a field of a dataclass."""

    help: str
    kind: Any = None
    """Type on the command line; None: for Python alone."""
    metavar: str = ""
    noun: str = ""
    """What a choice is a choice of."""
    allowed: Callable[[Any], bool] = lambda value: True
    wanted: str = ""
    """What is allowed, in words."""

    def __call__(self, *choices: str) -> dict[str, Any]:
        """The metadata of the field; choices: the values that this method takes, where they can be counted."""
        return {"option": self, "choices": choices}


METHOD = Option(
    "With attitude: linear (reading to field, as published) or forward. Without attitude: scalar (maximum likelihood of "
    "|B|), twostep or center (b alone). Spinner with sun pulses: batch or iterative. Filter that also estimates the "
    "attitude, from scanner and sun or from the reference: recursive. Tumbler, from gyro and magnetometer alone: gyro. all: "
    "compare the methods on rows that were not fitted, and select one. Default: linear with attitude, scalar without.",
    str,
    "NAME",
    "method",
)
PARAMETERS = Option("What to estimate: b, b,S or b,S,T; default: b,S.", str, "LIST", "choice of parameters")
DRIVER = Option(
    "Also estimate the field that follows this column: NAME of driver_NAME, or the name of another column "
    "(array_current_A, ...). all: try each driver_NAME and keep those that are significant. Repeatable.",
    list[str],
    "NAME",
)
_OF_READINGS = ("driver", "robust", "covariance", "block_s", "field_error_nT", "noise_nT", "lsb_nT", "passes")
"""Options that mean the same to a method and to the one that finds the fields for it."""
SCALAR = "fluxtwin.calib.scalar.calibrate:calibrate_scalar"
"""|B| knows nothing of the attitude, so no error of an attitude is in what it says of a column."""
ROBUST = Option(
    "Outliers: tukey (six robust sigma) leaves them out, none keeps them.", str, "KIND", "treatment of outliers"
)
COVARIANCE = Option(
    "blocks (allows for errors that are correlated in time) or white.", str, "KIND", "kind of covariance"
)
BLOCK_S = Option(
    "Length of a block [s]; otherwise found from the data.",
    float,
    "S",
    allowed=lambda value: 1e-3 <= value < float("inf"),
    wanted="seconds, at least 0.001",
)
FIELD_ERROR_NT = Option(
    "Error of the field model, rms per axis [nT], correlated over about an orbit; widens the sigmas.",
    float,
    "NT",
    allowed=lambda value: 0.0 <= value < float("inf"),
    wanted="nT, not negative",
)
NOISE_NT = Option("Noise of the reading, 1 sigma per axis [nT]; otherwise estimated.", float, "NT")
LSB_NT = Option("Least significant bit of the reading [nT]; otherwise estimated.", float, "NT")
ATTITUDE_SIGMA_DEG = Option(
    "Error of the reference attitude, or of the scanner, 1 sigma per body axis [deg]; otherwise estimated.",
    float,
    "DEG",
    allowed=lambda value: 1e-6 <= value < 90.0,
    wanted="degrees, positive, below 90",
)
ATTITUDE_TAU_S = Option(
    "Time constant of the attitude error [s]; 0 for white; otherwise estimated.",
    float,
    "S",
    allowed=lambda value: 0.0 <= value < 1e9,
    wanted="seconds, not negative",
)
SUN_SIGMA_DEG = Option(
    "Noise of a sun pulse or sun vector, 1 sigma [deg]; batch, iterative, recursive.",
    float,
    "DEG",
    allowed=lambda value: 0.0 < value < 90.0,
    wanted="degrees, positive, below 90",
)
PASSES = Option("(N,) labels of the joined rows: what a block is.")


@dataclass(frozen=True, kw_only=True)
class Options:
    """How a calibration is done. Raises BadInput, naming the option, for a value that is not allowed."""

    method: str

    def __post_init__(self) -> None:
        for item in fields(self):
            option, choices, value = item.metadata["option"], item.metadata["choices"], getattr(self, item.name)
            if choices:
                value = str(value).replace(" ", "")
                object.__setattr__(self, item.name, value)
                if value not in choices:
                    whose = "" if item.name == "method" else f" with method {self.method}"
                    wanted = " or ".join(filter(None, choices)) + whose
                    raise BadInput(f"{value!r} is no {option.noun}", where=f"--{item.name}", wanted=wanted)
            elif value is not None and not option.allowed(value):
                raise BadInput(f"{value!r}", where=item.name, wanted=option.wanted)


@dataclass(frozen=True)
class Estimator:
    """One method of calibration."""

    name: str
    needs: tuple[str, ...]
    """What the telemetry must have besides readings: positions, attitude, sun pulses, body rates."""
    options: type[Options]
    home: str
    """`module:function`, imported when it is used: `function(telemetry, model, options)` gives the `Fit`."""
    drivers_by: str = ""
    """`module:function` of the method that finds the fields of `--driver` where this one takes the spacecraft's own field
    for constant; empty where it fits them itself."""

    @property
    def takes(self) -> dict[str, Any]:
        """Its options: fields of the dataclass by name."""
        other = ("method", "telemetry_bias") if self.drivers_by else ("method",)
        return {item.name: item for item in fields(self.options) if item.name not in other}

    def fit(
        self,
        telemetry: Telemetry,
        model: FieldModel,
        given: Mapping[str, Any],
        progress: Progress = silent,
        *,
        sigmas: bool = True,
    ) -> Fit:
        """Calibrate a record by the options that are given. Errors as the method's own.

        sigmas: whether those of S and b have to contain what the fields of columns leave open, which takes refits.
        """
        progress(f"calibrating by {self.name}", 0.0)
        fit, options = _imported(self.home), self.options(method=self.name, **given)
        if not self.drivers_by or not given.get("driver"):
            return cast("Fit", fit(telemetry, model, options))
        from fluxtwin.calib.common.drivers import taken_out_first

        own = self.options(method=self.name, **{**given, "driver": ()})
        shared = {name: value for name, value in given.items() if name in _OF_READINGS}
        found = _imported(self.drivers_by)(telemetry, model, **shared)
        return taken_out_first(
            telemetry, found, lambda freed: cast("Fit", fit(freed, model, own)), progress, sigmas=sigmas
        )


def _imported(home: str) -> Callable[..., Any]:
    module, _, function = home.partition(":")
    return cast(Callable[..., Any], getattr(import_module(module), function))
