"""NPZ writer: one array per column, by name, and text arrays ``columns`` and ``units``."""

import zipfile

import numpy as np

from onboard.ground.log.export.spool import SpooledTable


class NpzTable(SpooledTable):
    """An NPZ file, for ``numpy.load``."""

    def close(self) -> None:
        """Finish the file."""
        try:
            with zipfile.ZipFile(self.path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                for number, column in enumerate(self.columns):
                    header = {
                        "descr": np.lib.format.dtype_to_descr(self.dtypes[number]),
                        "fortran_order": False,
                        "shape": (self.rows,),
                    }
                    with archive.open(f"{column.name}.npy", "w", force_zip64=True) as file:
                        np.lib.format.write_array_header_2_0(file, header)
                        for block in self.blocks(number):
                            file.write(block)
                for name, texts in (
                    ("columns", [c.name for c in self.columns]),
                    ("units", [c.unit for c in self.columns]),
                ):
                    with archive.open(f"{name}.npy", "w") as file:
                        np.lib.format.write_array(file, np.array(texts, np.str_), allow_pickle=False)
        finally:
            self.discard()
