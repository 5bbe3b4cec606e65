"""The SDO client: every transfer, every failure at every place, and the canopen library's server as a stranger."""

import canopen
import pytest
from canopen.objectdictionary import ObjectDictionary, ODArray, ODVariable, datatypes

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.profiles.cia404 import Cia404Config
from drivers.canopen_pdo.profiles.cia404 import LoadCell as LoadCellData
from drivers.canopen_pdo.profiles.cia406 import Cia406Config
from drivers.canopen_pdo.profiles.cia406 import Encoder as EncoderData
from drivers.canopen_pdo.sdo import SdoClient, SdoRead, SdoWrite, attempt, ensure_tpdo, read_unsigned, write_unsigned
from drivers.errors import ConfigurationError, NoAnswerError, SdoAbortError
from tests.drivers.can_peers import MS, Encoder, LoadCell, u32


class Exchange:
    """A client and a peer, joined; answers come 1 ms later. ``lose`` says which requests are lost on the way."""

    def __init__(self, peer):
        self.peer = peer
        self.now_ns = 0
        self.sent = []
        self.client = SdoClient(peer.number, lambda identifier, data: self.sent.append((identifier, data)))
        self.lose = lambda place: False
        self.requests = 0

    def run(self, sequence, limit_ms=20_000):
        """Run to the end; what the sequence returns."""
        result = []

        def keeping():
            result.append((yield from sequence))

        self.client.begin(keeping(), self.now_ns)
        for _ in range(limit_ms):
            self.now_ns += MS
            sent, self.sent = self.sent, []
            for identifier, data in sent:
                assert identifier == 0x600 + self.peer.number
                place = self.requests
                self.requests += 1
                answer = None if self.lose(place) else self.peer.sdo(data)
                if answer is not None:
                    self.client.accept(answer, self.now_ns)
            self.client.poll(self.now_ns)
            if not self.client.busy:
                return result[0] if result else None
        raise AssertionError("still busy")


def test_a_sequence_reads_writes_and_is_told_when():
    exchange = Exchange(Encoder())

    def sequence():
        first = yield SdoRead(0x6501)
        second = yield SdoWrite(0x1017, 0, b"\xf4\x01")
        return first, second

    first, second = exchange.run(sequence())
    assert (first.data, first.host_ns) == (u32(500_000), 1 * MS)
    assert (second.data, second.host_ns) == (b"", 2 * MS)
    assert exchange.peer.objects[0x1017, 0] == b"\xf4\x01"


def test_a_refusal_is_thrown_into_the_sequence_and_out_of_it_when_it_does_not_mind():
    exchange = Exchange(Encoder())
    assert exchange.run(attempt(0x9999, 0, 1, 2)) is False
    with pytest.raises(SdoAbortError, match=r"node 1 refuses to read 9999h:07: 06020000h, no such object") as caught:
        exchange.run(read_unsigned(0x9999, 7))
    assert caught.value.code == 0x0602_0000
    assert not exchange.client.busy
    with pytest.raises(SdoAbortError, match=r"write 1000h:00: 06010002h, read only"):
        exchange.run(write_unsigned(0x1000, 0, 1, 4))


def test_an_object_that_needs_segments_is_given_up_towards_the_server_too():
    exchange = Exchange(Encoder(objects={(0x1008, 0): b"an encoder"}))
    assert exchange.run(attempt(0x1017, 0, 0, 2))
    with pytest.raises(SdoAbortError, match="05040001h, command not known"):
        exchange.run(read_unsigned(0x1008))
    assert exchange.sent == [(0x601, bytes.fromhex("80 08 10 00 01 00 04 05"))]


def test_a_lost_request_is_repeated_and_a_silent_node_is_named():
    exchange = Exchange(Encoder())
    exchange.lose = lambda place: place < 2
    assert exchange.run(read_unsigned(0x6501)) == 500_000
    assert exchange.requests == 3
    exchange.lose = lambda place: True
    with pytest.raises(NoAnswerError, match=r"node 1 does not answer \(SDO 6001h:00\)"):
        exchange.run(read_unsigned(0x6001))
    assert exchange.requests == 6


def test_answers_to_other_requests_and_damaged_ones_are_left():
    client = SdoClient(1, lambda identifier, data: None)
    got = []

    def sequence():
        got.append((yield SdoRead(0x6501)))

    client.begin(sequence(), 0)
    client.accept(bytes.fromhex("43 01 60 00 01 00 00 00"), 1)  # another index
    client.accept(bytes.fromhex("43 01 65 01 01 00 00 00"), 1)  # another subindex
    client.accept(bytes.fromhex("60 01 65 00 00 00 00 00"), 1)  # a write's answer
    client.accept(bytes.fromhex("43 01 65 00"), 1)
    client.accept(b"", 1)
    assert client.busy
    assert client.malformed == 2
    client.accept(bytes.fromhex("43 01 65 00 07 00 00 00"), 2)
    assert not client.busy
    assert [(item.data, item.host_ns) for item in got] == [(u32(7), 2)]
    client.accept(bytes.fromhex("43 01 65 00 07 00 00 00"), 3)  # nothing under way: nothing happens


@pytest.mark.parametrize("present", ["right", "type", "cob", "off", "mapping", "empty"])
def test_a_tpdo_is_written_only_where_it_differs(present):
    changes = {
        "right": {},
        "type": {(0x1801, 2): b"\xfe"},
        "cob": {(0x1801, 1): u32(0x285)},
        "off": {(0x1801, 1): u32(0xC000_0281)},
        "mapping": {(0x1A01, 1): u32(0x6030_0110)},
        "empty": {(0x1A01, 0): b"\0"},
    }[present]
    peer = Encoder(objects=changes)
    exchange = Exchange(peer)
    exchange.run(ensure_tpdo(2, 0x281, 1, (0x6004_0020,)))
    writes = [request[1:] for request in peer.requests if request[0] == "write"]
    if present == "right":
        assert not writes
    else:
        assert writes[0][:2] == (0x1801, 1)
        assert writes[0][2] & 0x8000_0000
        assert writes[-1][:2] == (0x1801, 1)
        assert not writes[-1][2] & 0x8000_0000
    assert int.from_bytes(peer.objects[0x1801, 1], "little") & 0x8000_07FF == 0x281
    assert peer.objects[0x1801, 2] == b"\x01"
    assert (peer.objects[0x1A01, 0], peer.objects[0x1A01, 1]) == (b"\x01", u32(0x6004_0020))


# What each kind of node is asked


def encoder_data():
    return EncoderData(Cia406Config("joint_1", 1, 500_000))


def cell_data():
    return LoadCellData(Cia404Config("load_cell", 2, 50.0))


def test_the_encoder_is_asked_exactly_this():
    peer = Encoder()
    Exchange(peer).run(encoder_data().setup())
    assert peer.requests == [
        ("read", 0x6000, 0),
        ("read", 0x6501, 0),
        ("write", 0x6200, 0, 0),
        ("read", 0x1800, 1),
        ("write", 0x1800, 1, 0xC000_0181),
        ("read", 0x1A01, 0),
        ("read", 0x1A01, 1),
        ("read", 0x1801, 1),
        ("read", 0x1801, 2),
    ]


@pytest.mark.parametrize(
    ("objects", "counts"),
    [
        ({}, 500_000),
        ({(0x6000, 0): b"\x04\x00", (0x6001, 0): u32(4096)}, 4096),
        ({(0x6001, 0): u32(4096)}, 500_000),
        ({(0x6000, 0): None}, 500_000),
        ({(0x6000, 0): None, (0x6501, 0): None, (0x6001, 0): u32(4096)}, 4096),
    ],
)
def test_the_resolution_is_that_of_the_scaling_in_force(objects, counts):
    Exchange(Encoder(objects=objects)).run(EncoderData(Cia406Config("joint_1", 1, counts)).setup())
    with pytest.raises(ConfigurationError, match=f"encoder has {counts} counts/rev, configured 1000"):
        Exchange(Encoder(objects=objects)).run(EncoderData(Cia406Config("joint_1", 1, 1000)).setup())


def test_one_way_to_silence_the_event_tpdo_is_enough_none_is_an_error():
    Exchange(Encoder(read_only={(0x6200, 0)})).run(encoder_data().setup())
    Exchange(Encoder(read_only={(0x1800, 1)})).run(encoder_data().setup())
    with pytest.raises(ConfigurationError, match="event TPDO1"):
        Exchange(Encoder(read_only={(0x6200, 0), (0x1800, 1)})).run(encoder_data().setup())


@pytest.mark.parametrize(
    ("unit", "digits", "scale"),
    [(0x0021_0000, 4, 1e-4), (0xFD21_0000, 1, 1e-4), (0x0321_0000, 0, 1e3), (0x0021_0000, 0, 1.0)],
)
def test_the_scale_is_prefix_and_digits(unit, digits, scale):
    data = cell_data()
    Exchange(LoadCell(unit=unit, digits=digits)).run(data.setup())
    assert data.scale == scale


@pytest.mark.parametrize("unit", [0xFA01_0100, 0x0022_0000, 0x0021_0100, 0])
def test_another_unit_is_refused(unit):
    with pytest.raises(ConfigurationError, match=f"unit {unit:08X}h, not newton"):
        Exchange(LoadCell(unit=unit)).run(cell_data().setup())


def test_absurd_digits_are_refused():
    with pytest.raises(ConfigurationError, match="200 decimal digits"):
        Exchange(LoadCell(digits=200)).run(cell_data().setup())


@pytest.mark.parametrize(("data", "peer"), [(encoder_data, Encoder), (cell_data, LoadCell)])
def test_each_transfer_of_a_set_up_may_be_lost_twice_and_not_three_times(data, peer):
    reference = Exchange(peer())
    reference.run(data().setup())
    assert reference.requests > 5
    for place in range(reference.requests):
        exchange = Exchange(peer())
        exchange.lose = lambda number, place=place: place <= number < place + 2
        exchange.run(data().setup())
        assert exchange.peer.objects == reference.peer.objects
        exchange = Exchange(peer())
        exchange.lose = lambda number, place=place: number >= place
        with pytest.raises(NoAnswerError):
            exchange.run(data().setup())


@pytest.mark.parametrize(
    ("data", "peer", "needless"),
    [
        (encoder_data, Encoder, [0x6000, 0x6001, 0x6200, 0x6501, 0x1800, 0x1A00]),
        (cell_data, LoadCell, []),
    ],
)
def test_an_object_that_is_missing_is_done_without_or_the_set_up_ends(data, peer, needless):
    for key in set(peer().objects) - {(0x1000, 0), (0x1017, 0), (0x1800, 1)}:
        exchange = Exchange(peer(objects={key: None}))
        if key[0] in needless:
            exchange.run(data().setup())
        else:
            with pytest.raises(SdoAbortError):
                exchange.run(data().setup())


# A stranger: the canopen library's LocalNode


class Wire:
    """Stands where canopen expects a python-can bus; frames are carried by hand, without its threads."""

    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append((message.arbitration_id, bytes(message.data)))


def variable(name, index, subindex, kind, value, access="rw"):
    item = ODVariable(name, index, subindex)
    item.data_type, item.default, item.access_type = kind, value, access
    return item


def library_load_cell():
    dictionary = ObjectDictionary()
    dictionary.add_object(variable("device type", 0x1000, 0, datatypes.UNSIGNED32, 0x0002_0194, "ro"))
    for index, kind, value in [
        (0x6131, datatypes.UNSIGNED32, 0xFD21_0000),
        (0x6132, datatypes.UNSIGNED8, 2),
    ]:
        array = ODArray(f"{index:X}", index)
        array.add_member(variable("count", index, 0, datatypes.UNSIGNED8, 1))
        array.add_member(variable("one", index, 1, kind, value))
        dictionary.add_object(array)
    communication = ODArray("TPDO1", 0x1800)
    for subindex, kind, value in [
        (0, datatypes.UNSIGNED8, 2),
        (1, datatypes.UNSIGNED32, 0x182),
        (2, datatypes.UNSIGNED8, 255),
    ]:
        communication.add_member(variable(f"sub{subindex}", 0x1800, subindex, kind, value))
    dictionary.add_object(communication)
    mapping = ODArray("mapping", 0x1A00)
    for subindex, kind, value in [
        (0, datatypes.UNSIGNED8, 1),
        (1, datatypes.UNSIGNED32, 0x7130_0110),
        (2, datatypes.UNSIGNED32, 0),
    ]:
        mapping.add_member(variable(f"sub{subindex}", 0x1A00, subindex, kind, value))
    dictionary.add_object(mapping)
    wire = Wire()
    network = canopen.Network(wire)
    node = canopen.LocalNode(2, dictionary)
    network.add_node(node)
    return wire, network, node


def run_against_library(sequence):
    wire, network, node = library_load_cell()
    ours = []
    client = SdoClient(2, lambda identifier, data: ours.append((identifier, data)))
    client.begin(sequence, 0)
    transfers = 0
    while client.busy and transfers < 100:
        identifier, data = ours.pop(0)
        network.notify(identifier, bytearray(data), 0.0)
        transfers += 1
        for answered, answer in wire.sent:
            assert answered == frame.SDO_REPLY + 2
            client.accept(answer, transfers)
        wire.sent.clear()
    assert not client.busy
    return node


def test_the_canopen_library_takes_our_set_up_of_a_load_cell():
    data = cell_data()
    node = run_against_library(data.setup())
    assert data.scale == 1e-5
    assert node.sdo[0x1A00][0].raw == 2
    assert node.sdo[0x1A00][1].raw == 0x9130_0120
    assert node.sdo[0x1A00][2].raw == 0x6150_0108
    assert node.sdo[0x1800][1].raw == 0x182
    assert node.sdo[0x1800][2].raw == 1


def test_the_canopen_library_refuses_as_we_expect():
    with pytest.raises(SdoAbortError) as caught:
        run_against_library(read_unsigned(0x9130, 1))
    assert caught.value.code == 0x0602_0000
    with pytest.raises(SdoAbortError) as caught:
        run_against_library(write_unsigned(0x1000, 0, 1, 4))
    assert caught.value.code == 0x0601_0002
