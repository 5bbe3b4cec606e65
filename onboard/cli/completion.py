"""``heft completion`` prints the shell script for tab completion of commands, options and files."""

import argparse
from pathlib import Path

from onboard.cli.common import OK, Commands

_FILES = {"vehicle", "mapping"}  # taken by name too


def add(commands: Commands) -> None:
    """Make the command known."""
    completion = commands.add_parser(
        "completion",
        help="completion on the tab key, for bash, zsh or tcsh",
        description="bash: heft completion bash > ~/.local/share/bash-completion/completions/heft",
    )
    completion.add_argument("shell", choices=("bash", "zsh", "tcsh"))
    completion.set_defaults(command=_completion)


def _completion(arguments: argparse.Namespace) -> int:
    import shtab

    from onboard.cli import parser

    made = parser()
    _complete_files(made)
    print(shtab.complete(made, arguments.shell))
    return OK


def _complete_files(parser: argparse.ArgumentParser) -> None:
    import shtab

    for action in parser._actions:  # argparse lists them nowhere else
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _complete_files(command)
        elif action.type is Path or action.dest in _FILES:
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # where shtab looks for it
