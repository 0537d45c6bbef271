"""External estimators, asked for their options in processes of their own: who asks never imports them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait
from typing import Any

from cellslam.scenarios.estimator_options import Ask, Request, Tables, loaded, resolve
from cellslam.sim import supervisor
from cellslam.sim.errors import InputError, one_line
from cellslam.slam.registry import BrokenPluginError

LOAD_LIMIT_S = 300.0
END_S = 2.0  # a process that has closed its pipe has ended so soon


def requests(
    tables: Tables, names: Sequence[str], overrides: Iterable[str] = (), limit_s: float = LOAD_LIMIT_S
) -> tuple[Request, ...]:
    """Return what `estimator_options.resolve` does, without loading external estimators here; `limit_s`:
    of `asking`."""
    with asking(limit_s) as ask:
        return resolve(tables, names, overrides, ask)


@contextmanager
def asking(limit_s: float = LOAD_LIMIT_S) -> Iterator[Ask]:
    """Open a process for each module that is asked for an estimator; the value is the `ask` of `resolve`.

    A module may take `limit_s` to answer, and never more than `LOAD_LIMIT_S`.
    """
    asked: dict[str, subprocess.Popen[bytes]] = {}

    def ask(module: str, target: str, tables: Tables) -> tuple[str, Mapping[str, Any] | None, bool]:
        if module not in asked:
            asked[module] = _process()
        answer = _answer(asked[module], target, tables, min(limit_s, LOAD_LIMIT_S))
        if "wrong" in answer:
            raise InputError(answer["wrong"])
        if "broken" in answer:
            raise BrokenPluginError(answer["broken"])
        return answer["name"], answer["options"], bool(answer["oracle"])

    try:
        yield ask
    finally:
        for process in asked.values():
            supervisor.end(process)
            process.communicate()


def main() -> None:
    """Answer questions, a line of JSON each; what the estimators print goes elsewhere."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    path = json.loads(sys.stdin.readline())
    sys.path += [place for place in path if place and place not in sys.path]
    for question in sys.stdin:
        answers.write(_as_json(*json.loads(question)) + "\n")
        answers.flush()


def _as_json(target: str, tables: Tables) -> str:
    try:
        request = loaded(target, tables)
        options = None if request.options is None else request.options.model_dump(mode="json")
        return json.dumps({"name": request.name, "options": options, "oracle": request.oracle})
    except BrokenPluginError as error:
        return json.dumps({"broken": str(error)})
    except InputError as error:
        return json.dumps({"wrong": str(error)})
    except BaseException as error:
        return json.dumps({"broken": f"estimator '{target}': {type(error).__name__}: {one_line(error)}"})


def _process() -> subprocess.Popen[bytes]:
    supervised = "from cellslam.sim.supervisor import supervise; supervise(0, 1)"
    code = f"{supervised}; from cellslam.scenarios.external_options import main; main()"
    pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
    # -P: a file of the current directory must not hide a module.
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", code], stdin=pipe, stdout=pipe, stderr=quiet, start_new_session=True
    )
    _write(process, sys.path)
    return process


def _answer(process: subprocess.Popen[bytes], target: str, tables: Tables, limit_s: float) -> dict[str, Any]:
    """Ask one question. A process that does not answer, whatever the reason, is that of a broken estimator."""
    assert process.stdout is not None
    _write(process, [target, tables])
    answered = wait([process.stdout.fileno()], limit_s)
    try:
        answer: dict[str, Any] = json.loads(process.stdout.readline()) if answered else {}
        assert answer.keys() & {"wrong", "broken"} or answer.keys() == {"name", "options", "oracle"}
        return answer
    except (ValueError, AttributeError, AssertionError):
        if answered:
            with suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
        supervisor.end(process)
        ended = f"its process ended with exit status {process.returncode}"
        why = ended if answered else f"no answer in {limit_s:g} s"
        return {"broken": f"estimator '{target}': its module cannot be imported: {why}"}


def _write(process: subprocess.Popen[bytes], question: Any) -> None:
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.write(json.dumps(question).encode() + b"\n")
        process.stdin.flush()
