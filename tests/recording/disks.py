"""Disks that are cut off from power, with every file on them: what was synced is there, of the rest any part."""

from pathlib import Path


class PowerCutDisk:
    """Files whose every write and sync is remembered; the medium can be had as of any of these.

    A file's creation is durable at once: ``FileSink`` syncs the directory, as a test of its own says.
    """

    SECTOR = 512

    def __init__(self):
        self.history = []  # (what, path, offset, data)

    def open(self, path):
        self.history.append(("create", Path(path), 0, b""))
        return _Sink(self, Path(path))

    def after_power_cut(self, operations, rng):
        """The files after the first ``operations`` and a power cut: content by path."""
        safe, loose = {}, {}
        for what, path, offset, data in self.history[:operations]:
            if what == "create":
                safe[path], loose[path] = b"", []
            elif what == "write":
                loose[path].append((offset, data))
            else:
                safe[path], loose[path] = _written(safe[path], loose[path]), []
        return {path: self._medium(content, loose[path], rng) for path, content in safe.items()}

    def _medium(self, safe, loose, rng):
        """Any subset of the sectors that were not synced, zeros or no file end elsewhere."""
        image = bytearray(safe)
        for offset, data in loose:
            for sector in range(0, len(data), self.SECTOR):
                if rng.integers(2):
                    part = data[sector : sector + self.SECTOR]
                    image = bytearray(_written(image, [(offset + sector, part)]))
        return bytes(image)


def _written(content, writes):
    image = bytearray(content)
    for offset, data in writes:
        image.extend(bytes(max(0, offset + len(data) - len(image))))
        image[offset : offset + len(data)] = data
    return bytes(image)


class _Sink:
    def __init__(self, disk, path):
        self._disk, self._path = disk, path
        path.touch(exist_ok=False)

    def write_at(self, offset, data):
        self._disk.history.append(("write", self._path, offset, bytes(data)))

    def sync(self):
        self._disk.history.append(("sync", self._path, 0, b""))

    def taken(self):
        return None

    def close(self):
        pass
