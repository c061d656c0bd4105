"""The rows of a calibration without attitude: each pairs the reading B with the size |H| of the model field there.

Columns of telemetry (torquer dipole, currents, temperature) may be added, for fields that follow them. `ScalarProblem` has
the rows without units, and how the readings move in the body.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.design import Design, complete_rows, dipole_for_T, joined, radian_s
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.observability import direction_words, require_samples
from fluxtwin.calib.common.options import ScalarOptions
from fluxtwin.calib.scalar.model import ScalarData
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry

DIPOLES = ("dipole_x_Am2", "dipole_y_Am2", "dipole_z_Am2")
_SMALL = 1e-6
"""Noise in parts of the field, before it is known."""
_THIN = 0.05
"""A reading that moves by less than that share of the field along a direction keeps to a plane or a cone."""


def assemble_scalar(
    records: Telemetry | Sequence[Telemetry],
    model: FieldModel,
    *,
    with_dipole: bool = False,
    drivers: Mapping[str, FloatArray] | None = None,
) -> Design:
    """Rows with reading, position and these columns.

    drivers: (N,) columns of the joined telemetry that a field follows, by name. Raises BadInput where the dipole is asked
    for and absent, NoAnswer when no row is complete.
    """
    telemetry = joined(records)
    columns = dict(zip(DIPOLES, dipole_for_T(telemetry).T, strict=True)) if with_dipole else {}
    columns |= drivers or {}
    needs = {"no reading": telemetry.has_reading, "no position": telemetry.has_position}
    for name, values in columns.items():
        needs[f"no {name}"] = np.isfinite(values)
    rows, left_out = complete_rows(needs, "without attitude needs reading and position")
    used = telemetry.select(rows)
    assert used.r_N_km is not None
    return Design(
        time=used.time,
        B_nT=used.mag_B_nT,
        H_nT=np.linalg.norm(field_N_nT(model, used.time, used.r_N_km), axis=1),
        columns={name: values[rows] for name, values in columns.items()},
        rows=rows,
        left_out=left_out,
        radian_s=radian_s(used),
    )


class Geometry(NamedTuple):
    """How the readings move."""

    weakest_B: FloatArray
    """(3,) direction in which they move least."""
    moves_nT: FloatArray
    """(3,) rms along the eigen-directions, ascending."""
    field_nT: float
    """rms |H|."""
    constant_share: float
    """rms variation of |H| over its mean."""
    cone_axis_B: FloatArray
    """(3,) direction to which the angle of the readings changes least."""
    cone_spread: float
    """rms of the cosine of that angle about its mean."""

    def words(self) -> str:
        """How the readings keep to a line, a plane or a cone; empty where they do not."""
        thin = _THIN * self.field_nT
        if self.moves_nT[1] < thin:
            return f"the reading moves by {self.moves_nT[2]:.4g} nT along one line and hardly across it"
        if self.moves_nT[0] < thin:
            out = f"moves {self.moves_nT[0]:.3g} nT out of it" if self.moves_nT[0] > 0 else "leaves it within the noise"
            return f"the reading keeps to a plane with normal {direction_words(self.weakest_B)} (it {out})"
        if self.cone_spread < _THIN:
            return f"the reading keeps to a cone about {direction_words(self.cone_axis_B)}"
        return ""


class ScalarProblem(NamedTuple):
    """The rows at work, without units."""

    rows: Design
    options: ScalarOptions
    data: ScalarData
    scale_nT: float
    """rms |H|, the unit."""
    columns: tuple[str, ...]
    """Those that are not zero throughout."""
    units: FloatArray
    """(J,) rms of each of them."""

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) parameters as the calibration file has them; S is symmetric here."""
        names = ["S11", "S22", "S33", "S12", "S13", "S23"] if self.data.with_D else []
        names += ["b1", "b2", "b3"]
        for column in self.columns:
            axis = DIPOLES.index(column) + 1 if column in DIPOLES else 0
            names += [f"T{i}{axis}" if axis else f"{column} {'xyz'[i - 1]}" for i in (1, 2, 3)]
        return tuple(names)

    @property
    def drivers(self) -> list[str]:
        """The columns that are no dipole."""
        return [name for name in self.columns if name not in DIPOLES]

    @property
    def geometry(self) -> Geometry:
        """From the rows; the noise is taken off the moments."""
        data = self.data
        values, vectors = np.linalg.eigh(np.cov(data.B.T) - data.Sigma)
        unit = data.B / np.sqrt((data.B**2).sum(axis=1))[:, None]
        of_unit, axes = np.linalg.eigh(np.cov(unit.T))
        return Geometry(
            weakest_B=vectors[:, 0],
            moves_nT=np.sqrt(np.maximum(values, 0.0)) * self.scale_nT,
            field_nT=self.scale_nT,
            constant_share=float(np.std(data.H) / np.mean(data.H)),
            cone_axis_B=axes[:, 0],
            cone_spread=float(np.sqrt(max(of_unit[0], 0.0))),
        )

    def with_noise(self, noise: ReadingNoise) -> ScalarProblem:
        """The same with Sigma known."""
        least = (_SMALL * self.scale_nT) ** 2
        Sigma = np.diag(np.maximum(noise.variance_nT2, least)) / self.scale_nT**2
        return self._replace(data=self.data._replace(Sigma=Sigma))


def make_problem(rows: Design, options: ScalarOptions) -> ScalarProblem:
    """Scale the rows; columns that are zero throughout are dropped."""
    scale = float(np.sqrt((rows.H_nT**2).mean()))
    rms = {name: float(np.sqrt((values**2).mean())) for name, values in rows.columns.items()}
    columns = tuple(name for name, size in rms.items() if size > 0)
    units = np.array([rms[name] for name in columns])
    used = np.stack([rows.columns[name] for name in columns], axis=1) / units if columns else np.zeros((len(rows), 0))
    data = ScalarData(rows.B_nT / scale, rows.H_nT / scale, used, _SMALL**2 * np.eye(3), options.parameters != "b")
    require_samples(len(rows), data.size + 1)
    if not (data.B**2).sum() > 0:
        raise NoAnswer("the magnetometer reads zero throughout: nothing can be calibrated")
    return ScalarProblem(rows, options, data, scale, columns, units)
