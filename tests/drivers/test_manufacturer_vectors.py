"""Bytes that makers print in their manuals: one list, through our encoders and decoders.

Those that a test of one device holds already are not said again:

=====================================  ==============================  ======================================
vectors                                driver                          twin
=====================================  ==============================  ======================================
QSB Command List v1.28: set-up         test_qsb_line, test_qsb_device  hil_sim/devices/test_qsb (documented
sequence, EOR formats, factory values                                  sequence, demonstration, formats)
Baumer DSRT: 1000h, 6110h, autozero    test_canopen_frame              hil_sim/devices/test_canopen
Laumas TLB: read of 40008, CRC         test_modbus_frame               hil_sim/devices/test_modbus_load_cell
Mantracourt DSC: SOUT, BAUD, RST       test_dsc                        hil_sim/devices/test_dsc_load_cell
Memsense nIMU: table 3, by hand        test_nimu                       hil_sim/devices/test_nimu
=====================================  ==============================  ======================================
"""

import struct

import numpy as np
import pytest

from drivers.canopen_pdo import CanopenBus, CanopenObjectConfig, SyncConfig, frame
from drivers.modbus_load_cell import ModbusReply
from drivers.modbus_load_cell.frame import ModbusException, read_request
from drivers.qsb import QsbConfig, registers
from tests.drivers.batches import codes, whole
from tests.drivers.can_peers import Bench, PeerNode, u8, u16, u32

# US Digital, "QSB Command List" v1.28: what a joint with a sync pulse on digital input 0 is sent, in its order
QSB_SET_UP = ["W15F", "W0303", "W04000", "W0B0", "W0C1", "W0D1", "W02010", "S05", "S01", "S0E"]
# Baumer DSRT, operating manual pages 26 to 53
DSRT_READS = {
    (0x1000, 0): ("43 00 10 00 94 01 02 00", 0x0002_0194),
    (0x6110, 1): ("4B 10 61 01 46 00 00 00", 0x46),
    (0x6131, 1): ("43 31 61 01 00 01 01 FA", 0xFA01_0100),  # micrometre per metre
    (0x6132, 1): ("4F 32 61 01 02 00 00 00", 2),
    (0x1A00, 1): ("43 00 1A 01 10 01 30 71", 0x7130_0110),
}
DSRT_TPDO = bytes.fromhex("68 10")
# Laumas TLB, and "Modbus over serial line" V1.02 for the exception
TLB_REQUEST, TLB_EXCEPTION = "01 03 00 07 00 02 75 CA", "01 83 02 C0 F1"


def test_the_qsb_is_sent_what_its_command_list_says():
    sent = [command.text for command in (*registers.greeting_commands(), *registers.setup_commands(QsbConfig()))]
    assert [text for text in sent if text in QSB_SET_UP] == QSB_SET_UP
    assert set(sent) - set(QSB_SET_UP) == {"W161", "R14", "W000", "R05", "R01"}  # silence, who, mode, first values


@pytest.mark.parametrize(("place", "answer", "value"), [(at, *said) for at, said in DSRT_READS.items()])
def test_sdo_answers_of_the_strain_link(place, answer, value):
    index, subindex = place
    assert frame.encode_sdo_read(*place) == bytes.fromhex(f"40 {answer[3:11]} 00 00 00 00")
    reply = frame.decode_sdo_reply(bytes.fromhex(answer))
    assert (reply.index, reply.subindex, int.from_bytes(reply.data, "little")) == (index, subindex, value)


def test_laumas_request_and_exception():
    request = read_request(1, 7, 2)
    assert request == bytes.fromhex(TLB_REQUEST)
    with pytest.raises(ModbusException, match="2"):
        ModbusReply(request).receive(bytes.fromhex(TLB_EXCEPTION))


class StrainLink(PeerNode):
    """A DSRT as it leaves the factory, on SYNC: no heartbeat, the process value in TPDO1 of two bytes."""

    def __init__(self, number=5):
        super().__init__(
            number,
            {
                (0x1000, 0): u32(0x0002_0194),
                (0x1017, 0): u16(0),
                (0x1800, 1): u32(0x180 + number),
                (0x1800, 2): u8(1),
                (0x1A00, 0): u8(1),
                (0x1A00, 1): u32(0x7130_0110),
            },
        )

    def value(self, index, number, now_ns):
        assert index == 0x7130
        return DSRT_TPDO


def test_a_strain_link_flies_as_a_mapped_object_without_a_line_of_code(clock):
    """180h + id, DLC 2, 68 10: 4200 hundredths of a micrometre per metre, by configuration alone."""
    strain = CanopenObjectConfig("strain", 5, 1, 0, "i16", 0x7130, 1, "um/m", 0.01, synchronous=True)
    bench = Bench(clock, lambda port: CanopenBus(port, [strain], SyncConfig()), StrainLink())
    bench.start()
    bench.run(1_000)
    bench.stop()
    assert codes(bench.batches) == ["started", "stopped"]
    rows = whole(bench.batches, "strain")
    assert len(rows) == bench.nodes[5].answers > 150
    assert set(rows["value_raw"]) == {struct.unpack("<h", DSRT_TPDO)[0]}
    np.testing.assert_allclose(rows["value_raw"] * rows["scale"], 42.0)
    assert rows["unit"][0] == b"um/m"
