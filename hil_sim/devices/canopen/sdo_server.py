"""The SDO server of a simulated node (CiA 301, 7.2.4): expedited transfers; others are aborted with 05040001h."""

from hil_sim.devices.can_bus.object_dictionary import Abort, DictionaryError, ObjectDictionary


def serve(dictionary: ObjectDictionary, request: bytes, now_ns: int) -> tuple[bytes | None, tuple[int, int] | None]:
    """Do what eight bytes of an SDO request ask.

    Returns:
        The answer, None where there is none; and the object that was read, None where none was.
    """
    command, index, sub = request[0], int.from_bytes(request[1:3], "little"), request[3]
    specifier, head = command >> 5, request[1:4]
    if specifier == 4:  # the client aborts; an expedited transfer is over already
        return None, None
    try:
        if specifier == 2:
            value = dictionary.upload(index, sub, now_ns)
            return bytes([0x43 | (4 - len(value)) << 2]) + head + value.ljust(4, b"\0"), (index, sub)
        if specifier == 1 and command & 0x02:
            sized = bool(command & 0x01)
            length = 4 - (command >> 2 & 3) if sized else 4
            dictionary.download(index, sub, request[4 : 4 + length], sized=sized, now_ns=now_ns)
            return b"\x60" + head + bytes(4), None
        raise DictionaryError(Abort.COMMAND)
    except DictionaryError as abort:
        return b"\x80" + head + abort.code.to_bytes(4, "little"), None
