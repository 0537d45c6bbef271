"""What the Tab key offers: commands and options by argcomplete, scenarios and estimators by name."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from cellslam.scenarios.loading import preset_names
from cellslam.slam import registry


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell that asks to complete its line, and exit; needs the extra `completion`.

    Source: https://kislyuk.github.io/argcomplete.
    """
    import argcomplete
    from argcomplete.completers import FilesCompleter

    files = FilesCompleter(("toml",))
    for action in _actions(parser):
        if action.dest == "scenario":
            action.completer = lambda prefix, **_: [*preset_names(), *files(prefix)]  # type: ignore[attr-defined]
        elif action.dest == "estimators":
            action.completer = lambda **_: registry.names()  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in dict.fromkeys(action.choices.values()):
                yield from _actions(inner)
        else:
            yield action
