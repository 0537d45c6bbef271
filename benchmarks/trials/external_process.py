"""The process of one external estimator: drives it over what it is sent, and answers with plain numbers.

What it reads comes from cellslam and is pickled. What it writes comes from anyone's code and is data alone: messages
of `answers.encoded`, each after its length in eight bytes.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from cellslam.benchmarks.trials.answers import encoded
from cellslam.benchmarks.trials.child_process import bind
from cellslam.benchmarks.trials.estimation import answers, warm_up
from cellslam.benchmarks.trials.failures import details, explained
from cellslam.scenarios.estimator_options import Request, loaded


def main() -> None:
    """Serve the pipes whose numbers are the first two arguments; the third is the limit of memory in bytes."""
    requests, replies = os.fdopen(int(sys.argv[1]), "rb"), os.fdopen(int(sys.argv[2]), "wb")
    bind(int(sys.argv[3]))

    def reply(header: dict[str, Any], columns: dict[str, Any]) -> None:
        message = encoded(header, columns)
        replies.write(len(message).to_bytes(8, "little") + message)
        replies.flush()

    try:
        reply({}, {})
        name, path = pickle.load(requests)
        sys.path += [place for place in path if place and place not in sys.path]
        while True:
            options, drive = pickle.load(requests)
            _serve(name, options, drive, reply)
    finally:  # nothing that the estimator has left, a thread or a handler, keeps this process
        os._exit(1)


def _serve(name: str, options: str, drive: Any, reply: Callable[..., None]) -> None:
    """Reply when the estimator is compiled, then to each snapshot of a `drive` (recording, generator, map), if any."""
    try:
        request = _request(name, options)
        warm_up(request)
        reply({}, {})
        for answer in answers(drive[0], request, *drive[1:]) if drive is not None else ():
            header = {"seconds": answer.seconds, "remarks": answer.remarks, "peak_memory_mb": answer.peak_memory_mb}
            reply(header, answer.columns)
    except BaseException as error:
        reply({"error": explained(error), "details": details(error)}, {})


@lru_cache(maxsize=64)
def _request(name: str, options: str) -> Request:
    return loaded(name, json.loads(options) or {})
