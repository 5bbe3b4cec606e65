"""``heft import`` converts foreign recordings to logs."""

import argparse
from pathlib import Path

from onboard.cli.common import OK, Commands, add_json, progress, write_json


def add(commands: Commands) -> None:
    """Make the command known."""
    importer = commands.add_parser("import", help="convert foreign recordings to logs")
    importer.add_argument("mapping", help="mapping TOML, or a packaged one: tudelft, staubli_tx40, kuka_lwr4")
    importer.add_argument("source", type=Path, help="a recording, or a directory of them")
    importer.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    add_json(importer)
    importer.set_defaults(command=_import)


def _import(arguments: argparse.Namespace) -> int:
    from onboard.offline.bring_in.importer import import_recordings

    with progress() as bar:
        imported = import_recordings(arguments.mapping, arguments.source, arguments.output, progress=bar)
    write_json(arguments.json, imported)
    for one in imported:
        print(f"{one.path}  {one.rows} rows")
        for text in one.left_out:
            print(f"note: {text}")
    return OK
