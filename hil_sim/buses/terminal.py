"""The adapter's end of a pseudo-terminal."""

import errno
import os


def flush(master: int, output: bytearray) -> None:
    """Write as much of ``output`` as the terminal takes; discard all where no process has it open (EIO).

    Args:
        master: File descriptor; negative: none, nothing is done.
        output: What was not written stays in it.
    """
    if not output or master < 0:
        return
    try:
        del output[: os.write(master, output)]
    except BlockingIOError:
        return
    except OSError as error:
        if error.errno != errno.EIO:
            raise
        output.clear()
