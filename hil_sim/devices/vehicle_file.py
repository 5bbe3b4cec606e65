"""From a vehicle.toml, read here as a document of its own, to the scenario of its rehearsal.

Every device of the file gets its emulator on its bus, by ``Emulator.from_vehicle``; URDF, base, tolerances of links,
gravity, phases and what calibration has left of the IMU are the file's. What it does not say has defaults, which a
scenario file may override table by table.
"""

import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from hil_sim.devices import registry
from hil_sim.plants import urdf_drawing
from hil_sim.plants.urdf_drawing import PlantDrawing
from hil_sim.scenario import bed
from hil_sim.scenario.load import load, merged, names, parse
from hil_sim.scenario.sheets import Sheets, sheet
from hil_sim.scenario.tables import Files, ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

Table = dict[str, Any]
Over = str | Path | Mapping[str, Any]  # the path of a scenario file, or its tables

_REST_S, _REACH_S, _MOVE_S, _END_S = 4.0, 12.0, 24.0, 1.0
_PLACE_M = 5e-4  # of joints and IMUs of which the file says nothing, each coordinate
_BURNS = 0.15, 0.6  # of the mission: when each thruster is on for a second
_TRUSTED = 0.1  # relative sigma of a link, or less: its drawing is trusted, and the link within that
_GRAVITY = [0.0, 0.0, -9.80665]
_WIRING = ("canopen_sync", "sync_pulse")  # together the sync box
_OURS = ("pps", "pulse_generator")  # of the flight computer itself


def scenario_of(name: str | Path, over: Over | None = None, campaign: str | None = None) -> Scenario:
    """The scenario of a packaged mission or test bed by name, of a scenario file, or of a vehicle file's rehearsal.

    Args:
        name: of a packaged scenario or a test bed, or the path of a scenario or of a vehicle.toml.
        over: path of a scenario file whose tables lie over it, or these tables.
        campaign: of the test bed, by name.

    Raises:
        ScenarioError: a campaign that the bed has not; see :func:`rehearsal` and :func:`hil_sim.scenario.load.load`.
    """
    days = None if campaign is None else bed.campaign(str(name), campaign)
    file = _read(Path(name)) if str(name).endswith(".toml") else {}
    if "urdf" in file.get("vehicle", {}) and "scenario" not in file:
        return rehearsal(name, over)
    below = bed.find(str(file.get("scenario", {}).get("based_on")))
    if below is not None:
        return rehearsal(below.vehicle, name, over)
    flown = bed.find(str(name))
    if flown is not None:
        return rehearsal(flown.vehicle, flown.scenario, days, over)
    if not str(name).endswith(".toml") and name not in names():
        flies = ", ".join(sorted((*names(), *bed.names())))
        raise ScenarioError(
            f"nothing simulates {str(name)!r}: by name fly {flies}; others by the path of their vehicle.toml, if their "
            "devices are on buses and not columns of a recording"
        )
    own = {} if over is None else _without_vehicle(over)
    return load(name, {key: value for key, value in own.items() if key != "scenario"}, _texts(over))


def rehearsal(vehicle: str | Path, *overs: Over | None) -> Scenario:
    """The scenario that rehearses a vehicle.

    Args:
        vehicle: path of its vehicle.toml.
        overs: paths of scenario files whose tables lie over the defaults, each over those before it, or such tables.

    Raises:
        ScenarioError: a file that cannot be read, a device without emulator, a key that is unknown or out of range.
    """
    file = _read(Path(vehicle))
    said = _required(file, "vehicle", str(vehicle))
    urdf = Path(vehicle).parent / str(said.get("urdf"))
    try:
        text = urdf.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{vehicle}: its URDF {urdf} cannot be read ({error}); put it beside the file") from error
    drawing = urdf_drawing.read(text, urdf.name)
    table = _tables(file, said, drawing)
    table["vehicle"] = {key: said.get(key) for key in ("base", "base_link", "payload_link")}
    table["vehicle"] |= {"urdf": text, "label": urdf.name}
    table["scenario"] = {"name": str(said.get("name")), "description": f"the rehearsal of {vehicle}"}
    for over in overs:
        if over is not None:
            table = _laid_over(table, over)
    _drop_empty(table)
    files = _texts(*overs)
    return parse(table, " with ".join([f"rehearsal of {vehicle}", *(path for path, _ in files)]), files)


def _texts(*overs: Over | None) -> Files:
    """Path and text of those that are files."""
    return tuple((str(over), Path(over).read_text(encoding="utf-8")) for over in overs if isinstance(over, str | Path))


def _tables_of(over: Over) -> Table:
    return dict(over) if isinstance(over, Mapping) else _read(Path(over))


def _without_vehicle(over: Over) -> Table:
    own = _tables_of(over)
    if "vehicle" in own:
        raise ScenarioError(f"{over}: [vehicle] is the vehicle file's; take it out of the scenario")
    return own


def _laid_over(table: Table, over: Over) -> Table:
    """A scenario file's tables over those so far, and below them those of the test bed that it is based on."""
    own = _without_vehicle(over)
    header = own.pop("scenario", {})
    below = bed.find(str(header.get("based_on")))
    if below is not None:
        table = _laid_over(table, below.scenario)
    header = {key: value for key, value in header.items() if key in ("name", "description")}
    table = merged(table, {**own, "scenario": header})
    if not isinstance(over, Mapping):
        _find_csv(table, Path(over))
    if isinstance(own.get("capture"), dict):
        _say_when(table, own["capture"])
    elif "sequence" in own and "capture" not in own:
        _fit_capture(table)
    return table


def _tables(file: Table, said: Table, drawing: PlantDrawing) -> Table:
    """All tables but the vehicle's own."""
    estimation = file.get("estimation", {})
    phases = estimation.get("phases", {})
    devices = _required(file, "device", "the vehicle file")
    kinds = {name: device.get("kind") for name, device in devices.items()}
    sheets = Sheets(
        "sync_pulse" in kinds.values(),
        phases.get("channel"),
        estimation.get("imu_prior", estimation.get("doubt", {})),
        {name: joint.effort for name, joint in drawing.joints.items()},
        estimation.get("prior", {}).get("joint", {}),
    )
    out: Table = {"sensor": {}, "clock": {}, "bus": {}, "device": {}}
    for name, device in devices.items():
        if kinds[name] not in _WIRING:
            _add_device(out, name, device, sheets)
    _add_wiring(out, file, devices)
    out["as_built"] = _as_built(estimation, drawing)
    if estimation.get("method") == "exiddm":
        _displace(out["as_built"], estimation, drawing, [one["frame"] for one in devices.values() if _is_imu(one)])
    out["as_built"].pop(str(said.get("payload_link")), None)  # it is drawn as the payload
    out["physics"] = {"gravity_m_s2": said.get("gravity_m_s2", _GRAVITY) if _stands(said) else [0.0, 0.0, 0.0]}
    drag = estimation.get("gates", {}).get("specific_force_m_s2")
    if drag is not None:  # the base's motion is no drag to the gate
        out["base_motion"] = {"acceleration_m_s2": drag / 6.0, "rate_rad_s": 0.02}
    if estimation.get("zero") is not None:  # its accelerometer is zeroed at rest in free fall: it coasts
        out["base_motion"] = {"acceleration_m_s2": 0.0, "rate_rad_s": 0.02, "still_s": _REST_S}
    if said.get("base") == "planar":
        out["table"] = {"pucks": [puck["frame"] for puck in file.get("planar", {}).get("puck", ())]}
        out["table"]["tilt_sigma_m_s2"] = file.get("planar", {}).get("tilt_sigma_m_s2", 0.0)
    _add_mission(out, said, estimation, drawing)
    return out


def _stands(said: Table) -> bool:
    return said.get("base") in ("fixed", "planar", "pivot")


def _add_device(out: Table, name: str, device: Table, sheets: Sheets) -> None:
    kind = str(device.get("kind"))
    if kind in _OURS or kind.startswith("recorded_"):
        why = "has no bus" if kind not in _OURS else "is of the flight computer itself"
        raise ScenarioError(f"device.{name}: a {kind} {why} and cannot be rehearsed; take it out")
    emulator = registry.for_vehicle(kind)
    try:
        found = emulator.from_vehicle(name, device, sheets)
    except KeyError as error:
        raise ScenarioError(f"device.{name}: {error.args[0]!r} is missing; add it to the vehicle file") from error
    out["device"][name] = {"kind": registry.kind_of(emulator), "bus": device.get("bus"), **found.device}
    out["sensor"] |= found.sensors
    if emulator.has_clock:
        for clock, oscillator in {name: "crystal", **found.clocks}.items():
            out["clock"][clock] = sheet(f"clock.{oscillator}")


def _add_wiring(out: Table, file: Table, devices: Table) -> None:
    """Buses as their URLs say, and the sync box on CAN and on the pulse line."""
    syncs = {device["bus"]: (name, device) for name, device in devices.items() if device["kind"] == "canopen_sync"}
    lines = {device["bus"]: (name, device) for name, device in devices.items() if device["kind"] == "sync_pulse"}
    used = {device.get("bus") for device in devices.values()}
    for name, bus in file.get("bus", {}).items():
        if name in used:
            out["bus"][name] = _bus(name, str(bus.get("url")), syncs, lines)
    if len(syncs) > 1:
        raise ScenarioError(
            f"the CAN buses {', '.join(syncs)}: the sync box drives a single bus; rehearse them in turn"
        )
    if not syncs and not lines:
        return
    box: Table = {"kind": "sync_box"}
    for bus, (_, device) in syncs.items():
        box |= {"bus": bus, "period_ms": device["period_ms"]}
    for bus, (_, device) in lines.items():
        box |= {"line": bus, "period_ms": device["sync_period_ms"]}
    out["device"] = {"sync_box": box, **out["device"]}
    out["clock"]["sync_box"] = sheet("clock.crystal")


def _bus(name: str, url: str, syncs: Mapping[str, Any], lines: Mapping[str, Any]) -> Table:
    scheme, options = url.split(":", 1)[0], {key: values[0] for key, values in parse_qs(urlsplit(url).query).items()}
    try:
        match scheme.split("+")[0]:
            case "can":
                return {
                    "kind": "can",
                    "bit_rate": int(options.get("bitrate", 500_000)),
                    "sync_channel": syncs[name][0] if name in syncs else None,
                }
            case "gpio-pair":
                return {"kind": "pair"}
            case "gpio" | "pps":
                return {"kind": "pulse", "channel": lines[name][0]}
            case "serial":
                line = {"parity": options.get("parity", "N"), "stop_bits": int(options.get("stop_bits", 1))}
                return {"kind": "serial", "baud_rate": int(options["baud"]), **line}
            case "i2c" | "spi" | "tcp" | "udp" as plain:
                return {"kind": plain}
    except (KeyError, ValueError) as error:
        raise ScenarioError(f"bus.{name}: {url} lacks or has a wrong {error}; correct it") from error
    raise ScenarioError(f"bus.{name}: {scheme} can not be rehearsed; i2c, spi, can, serial, tcp, udp and gpio can")


def _as_built(estimation: Table, drawing: PlantDrawing) -> Table:
    """How far each link is from its drawing, by what the file states of it."""
    found: Table = {}
    prior = estimation.get("prior", {})
    for stated in (estimation.get("masses", {}).get("drawing", {}), prior.get("link", {})):
        for link, sigma in stated.items():
            if link in drawing.links:
                found[link] = {key: sigma[key] for key in ("mass_relative", "inertia_relative") if key in sigma}
                found[link]["centre_mm"] = 1e3 * sigma.get("centre_m", 1e-3)
    for link, relative in prior.get("relative", {}).items():
        if link in drawing.links and link not in found and relative <= _TRUSTED:
            found[link] = {"mass_relative": relative, "centre_mm": 1e2 * relative, "inertia_relative": relative}
    if estimation.get("method") == "exiddm":  # links that it does not name are certain to it
        found.setdefault("default", {"mass_relative": 0.0, "centre_mm": 0.0, "inertia_relative": 0.0})
    return found


def _is_imu(device: Table) -> bool:
    return "frame" in device and "gyro_noise_rad_s" in device


def _displace(found: Table, estimation: Table, drawing: PlantDrawing, imus: list[str]) -> None:
    """How far joints and IMUs are from where they are drawn, by what the file states or by :data:`_PLACE_M`."""
    stated = estimation.get("prior", {}).get("joint", {})
    places = {joint.child: stated.get(name, {}).get("position_m", _PLACE_M) for name, joint in drawing.joints.items()}
    places |= dict.fromkeys(imus, estimation.get("imu_prior", {}).get("position_m", _PLACE_M))
    for frame, sigma_m in places.items():
        link = drawing.link_at(frame)
        if link != drawing.root:
            found[link] = (found.get(link) or found["default"]) | {"place_mm": 1e3 * sigma_m}


def _add_mission(out: Table, said: Table, estimation: Table, drawing: PlantDrawing) -> None:
    """Payload, capture or ejection, and the sequence, in the phases that the file names."""
    phases = estimation.get("phases", {})
    taken, gone = phases.get("payload_taken"), phases.get("payload_gone")
    caught = not estimation.get("exiddm", {}).get("held_at_start", True)
    resting = estimation.get("zero", {}).get("phases", [0])[0]
    moving = [code for code in phases.get("identify", [1]) if code != resting] or [resting]
    last = phases.get("end", moving[-1])
    if said.get("payload_link") is not None:
        own = str(said["payload_link"])
        drawn_kg = dict(_weighed(drawing)).get(own, 0.0) if said.get("base") == "pivot" else 0.0  # it is a known mass
        out["payload"] = {"mass_kg": [drawn_kg, drawn_kg] if drawn_kg > 0.0 else _masses(drawing, own)}
        if taken is not None:
            out["capture"] = {"phase": taken, "velocity_sigma_m_s": 0.0, "rate_sigma_rad_s": 0.0}
            if not _stands(said):
                del out["capture"]["velocity_sigma_m_s"], out["capture"]["rate_sigma_rad_s"]
        elif caught:
            out["capture"] = {"earliest_s": _REST_S + 4.0, "latest_s": _REST_S + _REACH_S - 2.0}
        if gone is not None:
            out["ejection"] = {"phase": gone}
    steps: list[Table] = [{"phase": resting, "action": "hold", "duration_s": _REST_S}]
    if caught and taken is None:
        steps.append(_swing(moving[0], _REACH_S, 0.2))
    if taken is not None and taken not in (resting, moving[0]):
        steps += [_swing(moving[0], _REACH_S, 0.35)]
    if taken is not None:
        steps.append(_swing(taken, _MOVE_S, 0.35) if taken in moving else _hold(taken, 2.0))
    if taken is None or taken not in moving:
        steps.append(_swing(moving[-1], _MOVE_S, 0.35))
    if gone is not None:
        steps += [_hold(gone, 2.0), _swing(moving[-1], _MOVE_S, 0.35)]
    out["sequence"] = [*steps, _hold(last, _END_S)]
    end_s = sum(step["duration_s"] for step in out["sequence"])
    frames = [one["at"] for one in out["device"].values() if one["kind"] == "thruster"]
    out["burn"] = [
        {"frame": frame, "at_s": round(part * end_s + 1.5 * k, 3), "duration_s": 1.0}
        for k, frame in enumerate(frames)
        for part in _BURNS
    ]


def _swing(phase: int, duration_s: float, size: float) -> Table:
    return {"phase": phase, "action": "swing", "duration_s": duration_s, "swing": size}


def _hold(phase: int, duration_s: float) -> Table:
    return {"phase": phase, "action": "hold", "duration_s": duration_s}


def _masses(drawing: PlantDrawing, payload: str) -> list[float]:
    """A payload of 0.2 to 1 times what moves with the joints; within a quarter of the drawing where that has one."""
    masses = dict(_weighed(drawing))
    own = masses.pop(payload, 0.0)
    if own > 0.0:
        return [own / 1.25, own * 1.25]
    arm = sum(mass for link, mass in masses.items() if link != drawing.root) or sum(masses.values()) or 1.0
    return [0.2 * arm, arm]


def _weighed(drawing: PlantDrawing) -> Iterator[tuple[str, float]]:
    for link in urdf_drawing.elements(drawing, "link"):
        mass = link.find("inertial/mass")
        if mass is not None:
            value = float(mass.get("value", "nan"))
            if math.isfinite(value):
                yield str(link.get("name")).removeprefix(urdf_drawing.PREFIX), value


def _read(path: Path) -> Table:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path} cannot be read: {error}; give the path of a TOML file") from error
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{path} is not TOML: {error}; correct the file") from error


def _required(file: Table, key: str, label: str) -> Table:
    found = file.get(key)
    if not isinstance(found, dict):
        raise ScenarioError(f"{label} has no [{key}]; give the path of a vehicle.toml")
    return found


def _find_csv(table: Table, over: Path) -> None:
    """Files of motion lie beside the scenario that names them."""
    for key in ("csv", "segments"):
        name = table.get("motion", {}).get(key)
        if isinstance(name, str):
            table["motion"][key] = str(over.parent / name)


def _say_when(table: Table, capture: Table) -> None:
    """The time of a capture that a scenario file gives takes the place of the phase below it."""
    timed = {"earliest_s", "latest_s"} & capture.keys()
    if timed and "phase" in capture:
        raise ScenarioError(f"capture: phase and {min(timed)}: give either")
    if timed:
        table["capture"].pop("phase", None)
    phases = [step.get("phase") for step in table["sequence"] if isinstance(step, dict)]
    if "phase" in capture and capture["phase"] not in phases:
        known = ", ".join(sorted({str(phase) for phase in phases}))
        raise ScenarioError(f"capture.phase: no [[sequence]] has phase {capture['phase']!r}; there are {known}")


def _fit_capture(table: Table) -> None:
    """The default's capture, in a sequence that the scenario file gives: from a quarter to two fifths of it."""
    if "earliest_s" in table.get("capture", {}):
        end_s = sum(float(step.get("duration_s", 0.0)) for step in table["sequence"])
        table["capture"] |= {"earliest_s": 0.25 * end_s, "latest_s": 0.4 * end_s}


def _drop_empty(table: Table) -> None:
    """``capture = {}`` in a scenario file takes the default's away."""
    for key in ("payload", "capture", "ejection"):
        if table.get(key) == {} or table.get(key) is False:
            del table[key]
