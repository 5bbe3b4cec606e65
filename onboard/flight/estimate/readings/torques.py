"""Joint torques: what vehicle.toml states of them, as instruments of a free base's filter; their ticks, and in rows."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.devices.roles import LoadCellRole, Roles, TorqueKeys
from onboard.dynamics.model.errors import UrdfError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason, reasons
from onboard.identification.free_flyer.prediction.further import OF_FRICTION, CellPrior, Friction, FurtherCell
from onboard.regressor.rows import joint_torque_row


def torque_cell(
    vehicle: config.Vehicle, model: VehicleModel, cell: LoadCellRole, keys: TorqueKeys, samples: int
) -> FurtherCell:
    """The torque of a joint as a cell whose cut is that joint; friction and rotor where they are parameters.

    Args:
        vehicle: its file.
        model: of it.
        cell: the role.
        keys: its keys.
        samples: in a tick.

    Raises:
        UrdfError: a sigma that is not stated, or friction that is to be known of a joint at rest.
        UnknownFrameError: no such joint.
    """
    row = joint_torque_row(model, keys.joint)
    stated, kinds = vehicle.file.estimation.prior.absolute, OF_FRICTION if keys.friction else ()
    names = [f"bias_{cell.name}", *(f"{kind}_{keys.joint}" for kind in kinds)]
    if missing := [name for name in names if name not in stated]:
        text = f"[estimation.prior.absolute] has no sigma of {', '.join(missing)}, which the torque of {keys.joint} has"
        raise UrdfError(f"{text}; give it, or take torque_sigma_N_m out")
    if keys.friction and not keys.still_rad_s:
        text = f"the friction of {keys.joint} is not known at rest; give the rate below which its torque is left out"
        raise UrdfError(f"{text}, or say that there is no friction in it: torque_still_rad_s, torque_friction")
    bias, *friction = (stated[name] for name in names)
    prior = CellPrior(bias, 0.0, keys.scale_sigma, cell.delay_sigma_s)
    joint = [one.name for one in model.joints].index(keys.joint)
    own = Friction(joint, *(friction or (0.0, 0.0, 0.0)))
    return FurtherCell(cell.name, row.frame, row.projection, samples, prior, own)


class TorqueLines(NamedTuple):
    """The lines that are joint torques."""

    of_each: list[tuple[int, int, TorqueKeys]]  # line, joint, keys

    @classmethod
    def of(cls, roles: Roles, model: VehicleModel, rows: tuple[str, ...]) -> "TorqueLines":
        """Those among some rows, by their names."""
        joints = [one.name for one in model.joints]
        keys = {cell.name: cell.keys for cell in roles.cells if isinstance(cell.keys, TorqueKeys)}
        return cls([(at, joints.index(keys[row].joint), keys[row]) for at, row in enumerate(rows) if row in keys])

    def state(self, dq: FloatArray, sigma: FloatArray, refused: NDArray[np.int64], inflation: float = 1.0) -> None:
        """Put in the stated sigmas, which friction makes more than the samples' noise; refuse joints that are still.

        Args:
            dq: joint rates, (n, joints).
            sigma: of all lines, (n, lines), changed.
            refused: reasons, (n, lines), changed.
            inflation: of sigmas, for the correlation of neighbouring ticks.
        """
        for line, joint, keys in self.of_each:
            sigma[:, line] = keys.sigma_N_m * inflation
            refused[:, line] |= reasons(np.abs(dq[:, joint]) < keys.still_rad_s, GateReason.STILL)
