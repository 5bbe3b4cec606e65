"""``heft schema`` prints the JSON Schema of vehicle.toml."""

import argparse
from pathlib import Path

from onboard.cli.common import OK, Commands


def add(commands: Commands) -> None:
    """Make the command known."""
    schema = commands.add_parser(
        "schema",
        help="JSON Schema of vehicle.toml, for editors",
        description="Beside a vehicle.toml whose first line is '#:schema ./vehicle.schema.json' it makes editors with "
        "a TOML language server complete keys, check values and show what they mean.",
    )
    schema.add_argument("-o", "--output", type=Path, metavar="FILE", help="write it to FILE (default: print it)")
    schema.set_defaults(command=_schema)


def _schema(arguments: argparse.Namespace) -> int:
    from onboard.config.keys.schema import as_text

    text = as_text()
    if arguments.output is None:
        print(text, end="")
    else:
        arguments.output.write_text(text, encoding="utf-8")
        print(arguments.output)
    return OK
