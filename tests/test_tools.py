"""The makers' instruments can be imported, and take arguments."""

from __future__ import annotations

from argparse import ArgumentParser
from importlib import import_module

import pytest

from tools.__main__ import TOOLS


@pytest.mark.parametrize("name", TOOLS)
def test_a_tool_can_be_asked(name: str) -> None:
    module, parser = import_module(f"tools.{name.replace('-', '_')}"), ArgumentParser()
    module.add_arguments(parser)
    assert module.__doc__ and callable(module.command) and parser.format_help()
