"""The options of calibration methods, each declared once: its type, its help, what is allowed.

The options of a method are a dataclass, whose fields `OPTIONS` describes. The command line, the signature of
`fluxtwin.calibrate` and the refusal of what a method does not take follow from the dataclasses. `--help` reads this module,
so it imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, cast

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.progress import Progress, silent

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.sim.base.types import FloatArray
    from fluxtwin.sim.earth.field import FieldModel
    from fluxtwin.sim.telemetry.record import Telemetry


@dataclass(frozen=True)
class Option:
    """One option."""

    help: str
    kind: Any = None
    """Type on the command line; None: for Python alone."""
    metavar: str = ""
    noun: str = ""
    """What a choice is a choice of."""
    allowed: Callable[[Any], bool] = lambda value: True
    wanted: str = ""
    """What is allowed, in words."""


OPTIONS = {
    "method": Option(
        "With attitude: linear (reading to field, as published) or forward. Without attitude: scalar (maximum likelihood "
        "of |B|), twostep or center (b alone). Spinner with sun pulses: batch or iterative. Filter that also estimates the "
        "attitude, from scanner and sun or from the reference: recursive. Tumbler, from gyro and magnetometer alone: gyro. "
        "all: compare the methods on rows that were not fitted, and select one. Default: linear with attitude, scalar "
        "without.",
        str,
        "NAME",
        "method",
    ),
    "parameters": Option("What to estimate: b, b,S or b,S,T; default: b,S.", str, "LIST", "choice of parameters"),
    "driver": Option(
        "Also estimate the field that follows this column: NAME of driver_NAME, or the name of another column "
        "(array_current_A, ...). all: try each driver_NAME and keep those that are significant. Repeatable.",
        list[str],
        "NAME",
    ),
    "errors_in_variables": Option("Correct S for its attenuation by the noise of the reading; on for linear.", bool),
    "robust": Option(
        "Outliers: tukey (six robust sigma) leaves them out, none keeps them.", str, "KIND", "treatment of outliers"
    ),
    "covariance": Option(
        "blocks (allows for errors that are correlated in time) or white.", str, "KIND", "kind of covariance"
    ),
    "block_s": Option(
        "Length of a block [s]; otherwise found from the data.",
        float,
        "S",
        allowed=lambda value: 1e-3 <= value < float("inf"),
        wanted="seconds, at least 0.001",
    ),
    "field_error_nT": Option(
        "Error of the field model, rms per axis [nT], correlated over about an orbit; widens the sigmas.",
        float,
        "NT",
        allowed=lambda value: 0.0 <= value < float("inf"),
        wanted="nT, not negative",
    ),
    "attitude_sigma_deg": Option(
        "Error of the reference attitude, or of the scanner, 1 sigma per body axis [deg]; otherwise estimated.",
        float,
        "DEG",
        allowed=lambda value: 1e-6 <= value < 90.0,
        wanted="degrees, positive, below 90",
    ),
    "attitude_tau_s": Option(
        "Time constant of the attitude error [s]; 0 for white; otherwise estimated.",
        float,
        "S",
        allowed=lambda value: 0.0 <= value < 1e9,
        wanted="seconds, not negative",
    ),
    "noise_nT": Option("Noise of the reading, 1 sigma per axis [nT]; otherwise estimated.", float, "NT"),
    "lsb_nT": Option("Least significant bit of the reading [nT]; otherwise estimated.", float, "NT"),
    "weights": Option("(N,) weights of the joined rows, any scale (Lerner & Shuster 1981, eq. 4)."),
    "passes": Option("(N,) labels of the joined rows; rows with the same label form a block."),
    "sun_sigma_deg": Option(
        "Noise of a sun pulse or sun vector, 1 sigma [deg]; batch, iterative, recursive.",
        float,
        "DEG",
        allowed=lambda value: 0.0 < value < 90.0,
        wanted="degrees, positive, below 90",
    ),
    "sun_alignment_deg": Option(
        "How well the mounting of the sun sensor is known, 1 sigma [deg]; iterative; default: 0.05.",
        float,
        "DEG",
        allowed=lambda value: 0.0 < value < 90.0,
        wanted="degrees, positive, below 90",
    ),
    "inertia_ratio": Option(
        "Moment of inertia about the spin axis over that across it; iterative.",
        float,
        "JS/JT",
        allowed=lambda value: 0.0 < value < 2.0,
        wanted="Js/Jt, above 0 and below 2",
    ),
    "stretch_s": Option(
        "Length of a stretch over which the gyro is integrated [s]; gyro; default: the longest that fits three times.",
        float,
        "S",
        allowed=lambda value: 1.0 <= value <= 1800.0,
        wanted="seconds, 1 to 1800",
    ),
}
"""By the names of the fields that they describe, in the order in which they are offered."""
_OF_READINGS = ("driver", "robust", "covariance", "block_s", "field_error_nT", "noise_nT", "lsb_nT", "passes")
"""Options that mean the same to a method and to the one that finds the fields for it."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How a calibration is done. Raises BadInput, naming the option, for a value that is not allowed."""

    choices: ClassVar[dict[str, tuple[str, ...]]]
    """The values that the method takes, where they can be counted."""
    method: str

    def __post_init__(self) -> None:
        for item in fields(self):
            option, choices, value = OPTIONS[item.name], self.choices.get(item.name), getattr(self, item.name)
            flag = f"--{item.name.replace('_', '-')}"
            if choices:
                value = str(value).replace(" ", "")
                object.__setattr__(self, item.name, value)
                if value not in choices:
                    whose = "" if item.name == "method" else f" with method {self.method}"
                    wanted = " or ".join(filter(None, choices)) + whose
                    raise BadInput(f"{value!r} is no {option.noun}", where=flag, wanted=wanted)
            elif value is not None and not option.allowed(value):
                raise BadInput(f"{value!r}", where=flag, wanted=option.wanted)


@dataclass(frozen=True, kw_only=True)
class ReadingOptions(Options):
    """What every method of the product takes."""

    parameters: str = "b,S"
    driver: Sequence[str] = ()
    robust: str = "tukey"
    """`tukey`: readings beyond six robust sigma are left out, the others weigh alike."""
    noise_nT: float | FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class BlockOptions(ReadingOptions):
    """What a method takes whose errors may be correlated in time."""

    covariance: str = "blocks"
    block_s: float | None = None
    field_error_nT: float | None = None
    lsb_nT: float | FloatArray | None = None
    passes: Sequence[object] | None = None


@dataclass(frozen=True, kw_only=True)
class LinearOptions(BlockOptions):
    """How the regression is done."""

    choices: ClassVar = {
        "method": ("linear", "forward"),
        "parameters": ("b", "b,S", "b,S,T"),
        "robust": ("none", "tukey"),
        "covariance": ("white", "blocks"),
    }
    method: str = "linear"
    errors_in_variables: bool | None = None
    """None: on for `linear`. It also takes out the shortening by errors of the attitude."""
    attitude_sigma_deg: float | None = None
    attitude_tau_s: float | None = None
    weights: FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.errors_in_variables and self.method == "forward":
            raise BadInput(
                "method forward needs no correction for noise in the reading",
                where="errors_in_variables",
                wanted="method linear, or the correction off",
            )

    @property
    def corrects(self) -> bool:
        """Whether the errors-in-variables correction is made."""
        wanted = self.method == "linear" if self.errors_in_variables is None else self.errors_in_variables
        return wanted and self.parameters != "b"


@dataclass(frozen=True, kw_only=True)
class ScalarOptions(BlockOptions):
    """How the size of the field is compared; its drivers: Springmann & Cutler 2012."""

    choices: ClassVar = {
        "method": ("scalar", "twostep", "center"),
        "parameters": ("", "b", "b,S", "b,S,T"),
        "robust": ("none", "tukey"),
        "covariance": ("white", "blocks"),
    }
    method: str = "scalar"
    parameters: str = ""
    """Empty: `b` for center, `b,S` for the others."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.parameters:
            object.__setattr__(self, "parameters", "b" if self.method == "center" else "b,S")
        if self.method == "center" and self.parameters != "b":
            raise BadInput(f"{self.parameters!r}", where="parameters", wanted="'b': CENTER finds the bias alone")
        if self.method != "scalar" and "T" in self.parameters:
            raise BadInput("T", where="parameters", wanted="method scalar, which alone takes the torquers")


@dataclass(frozen=True, kw_only=True)
class SpinOptions(ReadingOptions):
    """How the motion and the magnetometer are found."""

    choices: ClassVar = {
        "method": ("batch", "iterative"),
        "parameters": ("b,S",),
        "covariance": ("white", "blocks"),
        "robust": ("tukey", "none"),
    }
    method: str = "batch"
    covariance: str = "blocks"
    lsb_nT: float | FloatArray | None = None
    sun_sigma_deg: float | None = None
    """None: found in the residual (batch), or 0.2."""
    sun_alignment_deg: float = 0.05
    inertia_ratio: float | None = None
    """None: that of the blind start."""


@dataclass(frozen=True, kw_only=True)
class RecursiveOptions(ReadingOptions):
    """What is known to the filter. The slow errors are states, so the covariance is always of the kind `blocks`."""

    choices: ClassVar = {
        "method": ("recursive",),
        "parameters": ("b,S", "b"),
        "robust": ("tukey",),
        "covariance": ("blocks",),
    }
    method: str = "recursive"
    covariance: str = "blocks"
    noise_nT: float | None = None
    lsb_nT: float | None = None
    attitude_sigma_deg: float | None = None
    attitude_tau_s: float | None = None
    sun_sigma_deg: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lsb_nT is not None and self.noise_nT is None:
            raise BadInput(
                f"{self.lsb_nT!r}",
                where="--lsb-nT",
                wanted="--noise-nT too: noise that is found includes rounding",
            )


@dataclass(frozen=True, kw_only=True)
class GyroOptions(ReadingOptions):
    """How the turning field is followed."""

    choices: ClassVar = {
        "method": ("gyro",),
        "parameters": ("b", "b,S"),
        "robust": ("none", "tukey"),
    }
    method: str = "gyro"
    stretch_s: float | None = None


@dataclass(frozen=True)
class Estimator:
    """One method of calibration."""

    name: str
    needs: tuple[str, ...]
    """What the telemetry must have besides readings: positions, attitude, sun pulses, body rates."""
    options: type[Options]
    home: str
    """`module:function`, imported when it is used: `function(telemetry, model, **options)` gives the `Fit`."""
    drivers_by: str = ""
    """`module:function` of the method that finds the fields of `--driver` where this one takes the spacecraft's own field
    for constant; empty where it fits them itself."""

    @property
    def takes(self) -> dict[str, Any]:
        """Its options: fields of the dataclass by name."""
        return {item.name: item for item in fields(self.options) if item.name != "method"}

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
        fit = partial(_imported(self.home), model=model, method=self.name, **given)
        if not self.drivers_by or not given.get("driver"):
            return fit(telemetry)
        from fluxtwin.calib.common.drivers import taken_out_first

        self.options(method=self.name, **given)  # refuses what is not allowed before the fields are looked for
        shared = {name: value for name, value in given.items() if name in _OF_READINGS}
        found = _imported(self.drivers_by)(telemetry, model, **shared)
        return taken_out_first(telemetry, found, partial(fit, driver=()), progress, sigmas=sigmas)


def _imported(home: str) -> Callable[..., Fit]:
    module, _, function = home.partition(":")
    return cast("Callable[..., Fit]", getattr(import_module(module), function))
