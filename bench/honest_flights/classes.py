"""Classes of flights of the scoreboard, and how a flight of each is drawn by its seed.

A class is a table: what flies, and a function that draws what is wrong. *Wrong file*: the vehicle that flies is not the
one that its file describes; the estimator reads the packaged file, and the simulated parts are as far off as stated.
*External wrench*: force and torque on the base that no instrument on board measures. *Mild*: instrument errors of half
the size at which revision 3bd6052 gave no answer, or less. Random flights are those of ``bench/plans/honesty.toml``:
healthy flights, and faults of the vocabulary, alone and in pairs.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bench.honest_flights.drawn import Drawn, draw, fault

LINKS = tuple(f"link_{number}" for number in range(1, 6))
JOINTS = tuple(f"joint_{number}" for number in range(1, 6))
AXES = tuple(f"wrist_{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz")
_PERCENT = (1.0, 2.0, 5.0, 10.0, 20.0)
_DRAG = 0.005, 0.0014  # N, N m: issue of the judgement; at 400 km of a base of this size
_LEAK = 0.020, 0.002

Tables = dict[str, Any]
Draw = Callable[[np.random.Generator, float], tuple[Tables, list[Tables]]]


class Class(NamedTuple):
    """A class of flights.

    Attributes:
        group: of classes, a heading of the scoreboard.
        vehicle: that flies.
        culprits: an event or reason that holds one of these names what is wrong; empty where nothing is.
        draw: of a generator and a size in per cent (0: drawn), the tables of the scenario, and faults.
        size: stated in per cent; 0: drawn of 1, 2, 5, 10 and 20.
        without: device that the estimator's vehicle file does not have.
    """

    group: str
    vehicle: str
    culprits: tuple[str, ...]
    draw: Draw
    size: float = 0.0
    without: str = ""


def _signed(rng: np.random.Generator, size: float) -> float:
    """A factor off by so many per cent in the file: what the part has over what the file says."""
    size = size or float(rng.choice(_PERCENT))
    return 1.0 / (1.0 + 0.01 * size * float(rng.choice([-1.0, 1.0])))


def _direction(rng: np.random.Generator) -> np.ndarray[Any, np.dtype[np.float64]]:
    made = rng.standard_normal(3)
    return np.asarray(made / np.linalg.norm(made))


def _healthy(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del rng, size
    return {}, []


def _base_mass(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    return {"as_built": {"base": {"mass_factor": _signed(rng, size)}}}, []  # of its inertia too: propellant used


def _base_inertia(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    return {"as_built": {"base": {"inertia_factor": _signed(rng, size)}}}, []


def _base_centre(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    off = float(rng.choice([5.0, 10.0, 20.0])) * _direction(rng)
    return {"as_built": {"base": {"centre_off_mm": off.tolist()}}}, []


def _all_masses(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    factor = _signed(rng, size)
    return {"as_built": {part: {"mass_factor": factor} for part in ("base", *LINKS)}}, []


def _link(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    link, factor = str(rng.choice(LINKS)), float(rng.choice([0.7, 0.85, 1.15, 1.3]))
    return {"as_built": {link: {"mass_factor": factor, "centre_off_mm": (5.0 * _direction(rng)).tolist()}}}, []


def _place(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    return {"as_built": {str(rng.choice(LINKS)): {"place_mm": 8.0}}}, []


def _base_and_imu(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    base, _ = _base_mass(rng, size)
    return base, [fault("wrong", "imu_base", 0.0, 0.01 * float(rng.choice([-1.0, 1.0])))]


def _turned(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    sigma_deg = float(rng.choice([1.5, 3.0]))
    return {"sensor": {"imu_base": {"mounting_sigma_deg": sigma_deg}}}, []


def _wrench(axes: str, force_n: float, torque_n_m: float) -> Draw:
    def made(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
        del size
        force, torque = force_n * _direction(rng), torque_n_m * _direction(rng)
        return {"wrench": [{"axes": axes, "force_N": force.tolist(), "torque_N_m": torque.tolist()}]}, []

    return made


def _scale(device: str) -> Draw:
    def made(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
        by = 0.01 * (size or float(rng.choice(_PERCENT))) * float(rng.choice([-1.0, 1.0]))
        return {}, [fault("wrong", device, 0.0, by)]

    return made


def _step(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    by, at_s = 0.01 * size * float(rng.choice([-1.0, 1.0])), float(rng.uniform(12.0, 24.0))
    return {}, [fault("wrong", "load_cell", at_s, by)]


def _late(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    return {}, [fault("delayed", str(rng.choice(JOINTS)), 0.0, 0.0025)]


def _stuck(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    starts_s = float(rng.uniform(10.0, 24.0))
    stuck = fault("stuck", str(rng.choice(JOINTS)), starts_s, 0.0)
    return {}, [stuck | {"end_s": starts_s + float(rng.uniform(1.0, 3.0))}]


def _cross_talk(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del rng, size
    axes = {"cross_axis_sigma": 0.01}
    return {"sensor": {imu: {"accel_g": axes, "gyro_deg_s": axes} for imu in ("imu_base", "imu_2")}}, []


def _slipped(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    joint, at_s, by_deg = str(rng.choice(JOINTS)), float(rng.uniform(3.0, 25.0)), size * float(rng.choice([-1.0, 1.0]))
    return {}, [fault("slipped", joint, at_s, by_deg)]


def _backlash(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    play = {"joint": str(rng.choice(JOINTS)), "gap_mrad": [1.5, 1.5]}
    # with play every joint of the world has a spring, of 20 Hz with nothing held: in some poses 130 Hz together; with
    # the payload they swing at 3 to 7 Hz: that is why these flights are refused, and they are without play too
    return {"backlash": play, "physics": {"integration_steps": 2}}, []


def _gripper(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    off = 3.0 * _direction(rng)
    return {"as_built": {"gripper": {"mass_factor": _signed(rng, size), "centre_off_mm": off.tolist()}}}, []


def _zero(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del size
    return {"sensor": {str(rng.choice(JOINTS)): {"zero_sigma_mrad": 30.0}}}, []


def _zeros(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del rng, size
    return {"sensor": {joint: {"zero_sigma_mrad": 3.0} for joint in JOINTS}}, []


def _of_one(devices: tuple[str, ...], kind: str, value: float) -> Draw:
    def made(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
        by = 0.01 * size * float(rng.choice([-1.0, 1.0])) if size else value
        return {}, [fault(kind, str(rng.choice(devices)), 0.0, by)]

    return made


def _heavy(rng: np.random.Generator, size: float) -> tuple[Tables, list[Tables]]:
    del rng, size
    return {"payload": {"mass_kg": [2.5, 3.5]}}, []


_DRAG_WRENCH, _LEAK_WRENCH = _wrench("space", *_DRAG), _wrench("base", *_LEAK)
CLASSES = {
    "healthy dymaflex": Class("healthy", "dymaflex", (), _healthy),
    "healthy dymaflex, no cell": Class("healthy", "dymaflex", (), _healthy, without="load_cell"),
    "healthy rocksat": Class("healthy", "rocksat", (), _healthy),
    "healthy workshop": Class("healthy", "workshop", (), _healthy),
    "base mass 10 %": Class("wrong file", "dymaflex", ("base",), _base_mass, 10.0),
    "base mass 5 %": Class("wrong file", "dymaflex", ("base",), _base_mass, 5.0),
    "base mass 20 %": Class("wrong file", "dymaflex", ("base",), _base_mass, 20.0),
    "base mass 10 %, no cell": Class("wrong file", "dymaflex", ("base",), _base_mass, 10.0, "load_cell"),
    "base inertia": Class("wrong file", "dymaflex", ("base",), _base_inertia),
    "base centre": Class("wrong file", "dymaflex", ("base",), _base_centre),
    "all masses 10 %": Class("wrong file", "dymaflex", ("masses", "base"), _all_masses, 10.0),
    "all masses 5 %": Class("wrong file", "dymaflex", ("masses", "base"), _all_masses, 5.0),
    "a link exchanged": Class("wrong file", "dymaflex", LINKS, _link),
    "a joint placed wrong": Class("wrong file", "dymaflex", JOINTS, _place),
    "base mass 7 % and gyro 1 %": Class("wrong file", "dymaflex", ("base", "imu_base"), _base_and_imu, 7.0),
    "IMU turned": Class("wrong file", "dymaflex", ("imu_base",), _turned),
    "cell 10 %": Class("scale of a cell", "dymaflex", ("load_cell",), _scale("load_cell"), 10.0),
    "cell 5 %": Class("scale of a cell", "dymaflex", ("load_cell",), _scale("load_cell"), 5.0),
    "cell steps by 2 %": Class("scale of a cell", "dymaflex", ("load_cell",), _step, 2.0),
    "drag": Class("external wrench", "dymaflex", ("disturbance", "wrench"), _DRAG_WRENCH),
    "leak": Class("external wrench", "dymaflex", ("disturbance", "wrench"), _LEAK_WRENCH),
    "drag, no cell": Class("external wrench", "dymaflex", ("disturbance", "wrench"), _DRAG_WRENCH, without="load_cell"),
    "mild: joint 2.5 ms late": Class("mild", "dymaflex", JOINTS, _late),
    "a joint stuck for a while": Class("mild", "dymaflex", JOINTS, _stuck),
    "a coupling slips by 3 deg": Class("mild", "dymaflex", JOINTS, _slipped, 3.0),
    "mild: cross-talk 1 %": Class("mild", "dymaflex", ("imu",), _cross_talk),
    "mild: backlash 1.5 mrad": Class("mild", "dymaflex", JOINTS, _backlash),
    "mild: gyro 1 %": Class("mild", "dymaflex", ("imu",), _scale("imu_base"), 1.0),
    "workshop, tool of 3 kg": Class("healthy", "workshop", (), _heavy),
    "workshop, gripper 10 %, 3 mm": Class("arm on a bench", "workshop", ("gripper", "cells"), _gripper, 10.0),
    "workshop, a zero 30 mrad": Class("arm on a bench", "workshop", ("zero", "level"), _zero),
    "workshop, zeros 3 mrad": Class("arm on a bench", "workshop", ("zero", "level", "joint"), _zeros),
    "workshop, an axis 5 %": Class("arm on a bench", "workshop", ("wrist",), _of_one(AXES, "wrong", 0.0), 5.0),
    "workshop, an encoder 2 %": Class("arm on a bench", "workshop", JOINTS, _of_one(JOINTS, "wrong", 0.0), 2.0),
    "workshop, a joint 5 ms late": Class("arm on a bench", "workshop", JOINTS, _of_one(JOINTS, "delayed", 0.005)),
    "workshop, an axis 5 ms late": Class("arm on a bench", "workshop", ("wrist",), _of_one(AXES, "delayed", 0.005)),
}


def of_class(name: str, seed: int) -> tuple[Drawn, str]:
    """What flies under a seed in a class, and the device that the estimator's file is without.

    Raises:
        ValueError: there is no such class.
    """
    if name not in CLASSES:
        raise ValueError(f"no class {name!r}; there are {', '.join(CLASSES)}")
    own = CLASSES[name]
    rng = np.random.default_rng([seed, 0x14])
    tables, faults = own.draw(rng, own.size)
    drawn = draw(seed, own.vehicle, healthy=True)
    return drawn._replace(faults=faults, model_errors={} if not tables else {name: tables}), own.without
