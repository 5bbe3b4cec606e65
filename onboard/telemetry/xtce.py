"""The packets as a mission database: XTCE 1.2 (OMG 20180204), by Yamcs' PyMDB.

Parameters are called by packet and field (``status_latched``). Where the names of a vehicle's quantities are given,
each has a container and numbers of its own (``m_payload_value``); others come as ``answer_value``. Commands are written
where the vehicle file arms any.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from yamcs.pymdb.commands import Argument, ArgumentEntry, Command, CommandLevel, FixedValueEntry, IntegerArgument
from yamcs.pymdb.containers import Container, ParameterEntry
from yamcs.pymdb.datatypes import Epoch
from yamcs.pymdb.encodings import (
    Charset,
    FloatEncoding,
    IntegerEncoding,
    IntegerEncodingScheme,
    IntegerTimeEncoding,
    StringEncoding,
)
from yamcs.pymdb.expressions import AndExpression, EqExpression, Expression, NeExpression, OrExpression
from yamcs.pymdb.parameters import (
    AbsoluteTimeParameter,
    EnumeratedParameter,
    FloatParameter,
    IntegerParameter,
    Parameter,
    StringParameter,
)
from yamcs.pymdb.systems import System
from yamcs.pymdb.verifiers import AcceptedVerifier, CompleteVerifier, ContainerCheck, ExecutionVerifier, FailedVerifier

from onboard.channels import NUMBERS, Order
from onboard.telemetry.packets import ANSWER, FRACTION, KINDS, P_FIELD, REPORT, VERSION, Field, PacketKind
from onboard.telemetry.uplink import SERVICE

ROOT = "space_packet"  # container to begin with
_ASKED = (("source", 16, "who asks: reports go to it"), ("session", 16, "of the packets that come down"))
_REPORTED_S = 30.0  # a command that is not reported in so long got lost, as heft telemetry --command takes it
_SENT_S = 24 * 3600.0  # a span of 10,000 rows over 20 bytes/s, what a busy line leaves it
_ORDERS = {  # what it is, how grave, its arguments: name, bits, meaning
    Order.MARK: ("A numbered line in the log", CommandLevel.NORMAL, [("number", 16, "of the mark")]),
    Order.STOP: ("The end of the flight", CommandLevel.CRITICAL, []),
    Order.SPAN: (
        "Events and answers of a span of the log once more",
        CommandLevel.NORMAL,
        [("begin", 32, "seconds since 1970"), ("end", 32, "seconds since 1970")],
    ),
}


def database(name: str, apids: Mapping[str, int], quantities: Sequence[str] = (), command_apid: int = 0) -> str:
    """The mission database, XML.

    Args:
        name: of the space system.
        apids: by kind of packet.
        quantities: that the vehicle answers, as far as they are known before a flight.
        command_apid: of commands; 0: none are taken.
    """
    system = System(_name(name), short_description="Downlink of a heft flight")
    apid, heads = _heads(system, apids)
    for kind in KINDS.values():
        _kind(system, kind, heads[bool(kind.lead)], EqExpression(apid, apids[kind.name]), quantities)
    if command_apid:
        _commands(system, command_apid, _reports(system))
    return str(system.dumps(top_comment=False))


def _reports(system: System) -> dict[str, ContainerCheck]:
    """What verifies a command: that its report comes. Of commands under way at once the first report is each one's."""
    report, subtype = system.find_container("report"), system.find_parameter("pus_subtype")
    checks = {"failed": ContainerCheck(system.find_container("failure"))}
    for word, number in (("accepted", 1), ("begun", 3), ("completed", 7)):
        condition, meaning = EqExpression(subtype, number), f"a command was {word}"
        checks[word] = ContainerCheck(_container(system, f"report_{word}", [], report, condition, meaning))
    return checks


def _commands(system: System, apid: int, reports: Mapping[str, ContainerCheck]) -> None:
    """Commands without what a link adds to any packet: sequence count, length, CRC-16."""

    def fixed(name: str, value: int, bits: int) -> FixedValueEntry:
        return FixedValueEntry(name=name, binary=f"{value:04x}", bits=bits)

    def argument(name: str, bits: int, meaning: str) -> Argument[int]:
        coded = IntegerEncoding(bits)
        return IntegerArgument(name, signed=False, bits=32, short_description=meaning, encoding=coded)

    head = (("version", 0, 3), ("type", 1, 1), ("secondary_header", 1, 1), ("apid", apid, 11), ("flags", 3, 2))
    counted = (("sequence_count", 0, 14), ("packet_data_length", 0, 16))
    service = (("pus_version", 2, 4), ("acknowledge", 15, 4), ("service", SERVICE, 8))
    for order, (meaning, level, own) in _ORDERS.items():
        arguments = [argument(*one) for one in (*_ASKED, *own)]
        entries = [fixed(*one) for one in (*head, *counted, *service, ("subtype", int(order), 8))]
        long = order is Order.SPAN
        command = Command(
            system,
            order.name.lower(),
            arguments=arguments,
            entries=[*entries, *map(ArgumentEntry, arguments)],
            short_description=meaning,
            level=level,
        )
        done_s = _SENT_S if long else _REPORTED_S
        command.accepted_verifier = AcceptedVerifier(reports["accepted"], timeout=_REPORTED_S)
        command.execution_verifiers = [ExecutionVerifier(reports["begun"], timeout=_REPORTED_S)] if long else []
        command.complete_verifiers = [CompleteVerifier(reports["completed"], timeout=done_s)]
        command.failed_verifier = FailedVerifier(reports["failed"], timeout=done_s)


def _heads(system: System, apids: Mapping[str, int]) -> tuple[Parameter[Any], tuple[Container, Container]]:
    """The parameter that tells kinds apart, and the containers of headers: without a PUS header, and with one."""

    def number(name: str, bits: int, meaning: str) -> Parameter[Any]:
        return IntegerParameter(
            system, name, signed=False, bits=32, short_description=meaning, encoding=IntegerEncoding(bits)
        )

    apid = number("apid", 11, "Application process identifier: the kind of packet")
    definitions = number("definitions", 8, "Number of the packets' definitions")
    p_field = number("time_p_field", 8, "P-field of the CUC time code")
    primary = [
        number("packet_version", 3, "Packet version number"),
        number("packet_type", 1, "0: telemetry"),
        number("secondary_header", 1, "1: it is there"),
        apid,
        number("sequence_flags", 2, "3: unsegmented"),
        number("sequence_count", 14, "Of this APID and session"),
        number("packet_data_length", 16, "Bytes after this field, less 1"),
    ]
    secondary = [
        p_field,
        AbsoluteTimeParameter(
            system,
            "time",
            Epoch.UNIX,
            short_description="CUC time: 4 bytes of seconds, 3 of fraction",
            encoding=IntegerTimeEncoding(56, scale=1.0 / FRACTION),
        ),
        definitions,
        number("session", 16, "Drawn by each process that sends"),
    ]
    packet = Container(system, ROOT, [ParameterEntry(one) for one in primary], abstract=True)
    ours = AndExpression(EqExpression(definitions, VERSION), EqExpression(p_field, P_FIELD))
    pus = [EqExpression(apid, apids[kind.name]) for kind in KINDS.values() if kind.lead]
    others = [NeExpression(apid, apids[kind.name]) for kind in KINDS.values() if kind.lead]

    def head(name: str, lead: Sequence[Parameter[Any]], condition: Expression) -> Container:
        entries = [ParameterEntry(one) for one in (*lead, *secondary)]
        header = Container(system, f"{name}_header", entries, base=packet, abstract=True, condition=condition)
        return Container(system, f"{name}_packet", base=header, abstract=True, condition=ours)

    lead = [_parameter(system, f"pus_{field.name}", field) for field in REPORT.lead]
    return apid, (head("heft", [], AndExpression(*others)), head("pus", lead, OrExpression(*pus)))


def _kind(system: System, kind: PacketKind, head: Container, is_kind: EqExpression, quantities: Sequence[str]) -> None:
    fields = {field.name: _parameter(system, f"{kind.name}_{field.name}", field) for field in kind.fields}
    error_control = Field("error_control", "H", "Packet error control: CRC-16")
    check = _parameter(system, f"{kind.name}_error_control", error_control)
    if kind is not ANSWER or not quantities:
        _container(system, kind.name, [*fields.values(), check], head, is_kind, kind.meaning)
        return
    common = [one for name, one in fields.items() if name not in NUMBERS]
    base = _container(system, kind.name, common, head, is_kind, kind.meaning, abstract=True)
    which = fields["quantity"]
    numbers = [field for field in kind.fields if field.name in NUMBERS]
    for quantity, name in _names(quantities):
        own = [_parameter(system, f"{name}_{field.name}", field) for field in numbers]
        _container(system, f"answer_{name}", [*own, check], base, EqExpression(which, quantity), quantity)
    others = [fields[name] for name in NUMBERS]
    known = [NeExpression(which, quantity) for quantity in quantities]
    none = AndExpression(*known) if len(known) > 1 else known[0]
    _container(system, "answer_other", [*others, check], base, none, "of a quantity that was not known before")


def _container(
    system: System,
    name: str,
    parameters: Iterable[Parameter[Any]],
    base: Container,
    condition: Expression,
    meaning: str,
    *,
    abstract: bool = False,
) -> Container:
    entries = [ParameterEntry(one) for one in parameters]
    return Container(
        system, name, entries, base=base, abstract=abstract, condition=condition, short_description=meaning
    )


def _parameter(system: System, name: str, field: Field) -> Parameter[Any]:
    units, said, bits = field.unit or None, field.meaning, field.bits
    if field.is_text:
        coded = StringEncoding(bits, charset=Charset.UTF_8, termination=b"\0")
        return StringParameter(system, name, short_description=said, encoding=coded)
    if field.code == "f":
        return FloatParameter(system, name, short_description=said, units=units, encoding=FloatEncoding(bits))
    if field.choices:
        choices = list(field.choices)
        return EnumeratedParameter(system, name, choices, short_description=said, encoding=IntegerEncoding(bits))
    signed = field.code.islower()
    scheme = IntegerEncodingScheme.TWOS_COMPLEMENT if signed else IntegerEncodingScheme.UNSIGNED
    encoding, wide = IntegerEncoding(bits, scheme=scheme), max(32, bits)
    return IntegerParameter(
        system, name, signed=signed, bits=wide, short_description=said, units=units, encoding=encoding
    )


def _name(text: str) -> str:
    return re.sub(r"\W", "_", text, flags=re.ASCII) or "_"


def _names(quantities: Iterable[str]) -> list[tuple[str, str]]:
    """Each quantity with a name that XTCE allows, no two the same, none of a packet's."""
    taken, found = {_name(kind) for kind in (*KINDS, "other")}, []
    for quantity in quantities:
        name = _name(quantity)
        while name in taken:
            name += "_"
        taken.add(name)
        found.append((quantity, name))
    return found
