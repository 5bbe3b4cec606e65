"""The processes of a real flight: acquisition, estimation, recording. Each runs its worker's step until told to stop.

Only the acquisition process is hurried: a thread for each bus, blocked in I/O or asleep till its next poll, and nothing
else in that process.
"""

import gc
import os
import threading
import time
from collections.abc import Sequence
from multiprocessing.synchronize import Event
from pathlib import Path

from drivers.device import Device
from drivers.records import Severity, event
from onboard import config
from onboard.flight import rings
from onboard.flight.acquisition import Acquisition
from onboard.flight.publisher import Publisher

RECEIVE_TIMEOUT_S = 0.05
REALTIME_PRIORITY = 50


def acquire(vehicle: config.Vehicle, directory: Path, ready: Event, stop: Event) -> None:
    """Body of the acquisition process."""
    from onboard.flight.devices import open_devices

    publisher = Publisher(rings.create(directory, vehicle, rings.device_channels(vehicle)))
    opened = open_devices(vehicle, time.monotonic_ns)
    acquisition = Acquisition(opened.devices, publisher)
    acquisition.report(opened.problems)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REALTIME_PRIORITY))
    except OSError as error:
        text = f"no real-time priority ({error.strerror}): grant rtprio to this user, or samples may arrive late"
        acquisition.report([event(time.monotonic_ns(), Severity.INFO, "not_realtime", "acquisition", text)])
    gc.collect()
    gc.freeze()
    threads = [
        threading.Thread(target=_pump_bus, args=(acquisition, devices, stop), name=bus, daemon=True)
        for bus, devices in opened.by_bus.items()
    ]
    for thread in threads:
        thread.start()
    ready.set()
    for thread in threads:
        thread.join()
    stop.wait()  # with no bus at all there is still a flight to log
    opened.close()


def _pump_bus(acquisition: Acquisition, devices: Sequence[Device], stop: Event) -> None:
    """All devices of one bus: they share a port, so one thread drives them."""
    running = [device for device in devices if acquisition.start_device(device, time.monotonic_ns())]
    due_ns = {device.name: 0 for device in running}
    while running and not stop.is_set():
        for device in running:
            now_ns = time.monotonic_ns()
            if now_ns >= due_ns[device.name]:
                acquisition.pump(device, now_ns, RECEIVE_TIMEOUT_S if device.period_ns == 0 else 0.0)
                due_ns[device.name] = max(due_ns[device.name] + device.period_ns, now_ns)
        wait_ns = min(due_ns.values()) - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns * 1e-9)
    for device in running:
        acquisition.stop_device(device, time.monotonic_ns())


def estimate(vehicle: config.Vehicle, directory: Path, ready: Event, stop: Event) -> None:
    """Body of the estimation process."""
    from onboard.flight.estimation import EstimationWorker

    worker = EstimationWorker.over_rings(vehicle, directory)
    ready.set()
    period_ns = int(vehicle.file.estimation.step_ms * 1e6)
    next_ns = time.monotonic_ns()
    while not stop.is_set():
        worker.step(time.monotonic_ns())
        next_ns = max(next_ns + period_ns, time.monotonic_ns())
        time.sleep(max(0, next_ns - time.monotonic_ns()) * 1e-9)
    worker.finish(time.monotonic_ns())


def record(vehicle: config.Vehicle, directory: Path, log: Path, ready: Event, stop: Event) -> None:
    """Body of the recording process."""
    from onboard.flight.flight_log import Started, open_recorder

    started = Started(time.time_ns(), time.monotonic_ns())
    recorder = open_recorder(vehicle, directory, log, durable=True, started=started)
    ready.set()
    while not stop.is_set():
        recorder.step(time.monotonic_ns())
        time.sleep(0.05)
    recorder.close(time.monotonic_ns())
