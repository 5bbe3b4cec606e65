"""What the keys of ``[realtime]`` and ``[telemetry]`` mean, and when to change them; see ``meanings``."""

REALTIME: dict[str, tuple[str, ...]] = {
    "acquisition_priority": (
        "SCHED_FIFO priority of acquisition, 1 to 99; 0: none. Needs LimitRTPRIO.",
        "the bus drivers' interrupt threads (50) have to come first: below 50",
    ),
    "acquisition_cpus": (
        "Numbers of the cores that acquisition may run on; all where empty.",
        "a core is kept for it (isolcpus, or CPUAffinity of other services)",
    ),
    "recording_priority": (
        "The same of recording, below that of acquisition; 0: none.",
        "other programs keep the computer busy for seconds",
    ),
    "recording_cpus": ("The same of recording.", "acquisition has a separate core"),
    "lock_memory": (
        "Memory of acquisition and recording is never swapped out. Needs LimitMEMLOCK=infinity.",
        "the computer swaps, or memory is short",
    ),
    "freeze_gc": (
        "The garbage collectors of the workers leave alone what was there at the start.",
        "never in flight; to look for leaks",
    ),
}

TELEMETRY: dict[str, tuple[str, ...]] = {
    "bytes_s": (
        "What all packets of `--telemetry` may take; a serial line takes no more than it carries.",
        "the radio carries more, or less",
    ),
    "status_hz": ("Packets of the flight's health and of the downlink's.", "the budget is small"),
    "answers_hz": ("Packets of each quantity.", "the budget is small, or large"),
    "phase_hz": ("Packets of mode and phase, besides those at each change.",),
    "flight_hz": ("Packets that say which flight it is, and its clocks.",),
    "reasons_hz": ("Packets of why an answer is no better, besides those at each change.",),
    "status_apid": ("Application process identifier of these packets.", "another part of the spacecraft has it"),
    "answer_apid": ("The same of answers.", "as above"),
    "phase_apid": ("The same of mode and phase.", "as above"),
    "event_apid": ("The same of events.", "as above"),
    "reason_apid": ("The same of reasons.", "as above"),
    "flight_apid": ("The same of the flight's name and clocks.", "as above"),
    "report_apid": ("The same of reports that a command was accepted, started, completed.", "as above"),
    "failure_apid": ("The same of reports that it was not.", "as above"),
    "command_apid": ("Of the commands that are taken.", "as above"),
    "commands": (
        "What may be asked of the flight over the link of `--telemetry`, and on its page: nothing else.",
        "who can send on the link, or use this computer, may do so",
    ),
}
