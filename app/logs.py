"""Logs are events with fields on stderr, our own and those of libraries: a JSON object a line, or a line to read."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import threading
from types import TracebackType
from typing import TextIO, cast

import structlog
from structlog.typing import Processor


class _Stderr:
    """Drops what cannot be written: a log on a full disk must not stop the work it tells of."""

    def write(self, text: str) -> None:
        with contextlib.suppress(OSError):
            sys.stderr.write(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            sys.stderr.flush()


def set_up_logs() -> None:
    """Send our events and other libraries' warnings to stderr: lines for people on a terminal, JSON elsewhere."""
    stream = cast(TextIO, _Stderr())
    terminal = sys.stderr.isatty()
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False)
        if terminal
        else structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    rendered: list[Processor] = (
        [
            structlog.dev.ConsoleRenderer(
                colors="NO_COLOR" not in os.environ, exception_formatter=structlog.dev.plain_traceback
            )
        ]
        if terminal
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    )
    structlog.configure(processors=[*shared, *rendered], logger_factory=structlog.PrintLoggerFactory(stream))
    handler = logging.StreamHandler(stream)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[*shared, structlog.stdlib.add_logger_name],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *rendered],
        )
    )
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.captureWarnings(capture=True)
    _tell_what_nobody_caught()
    # The engine would bring a handler of its own, which writes text.
    engine = logging.getLogger("dbos")
    engine.handlers, engine.propagate = [handler], False


def _tell_what_nobody_caught() -> None:
    """Have errors that end a thread or the process, or that nobody could be told of, be events like others."""
    uncaught = structlog.get_logger("uncaught")

    def ends_process(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, KeyboardInterrupt):
            sys.__excepthook__(kind, error, trace)
        else:
            uncaught.critical("the process ends by an error", exc_info=(kind, error, trace))

    def ends_thread(told: threading.ExceptHookArgs) -> None:
        error = told.exc_value or told.exc_type()
        name = None if told.thread is None else told.thread.name
        uncaught.error(
            "a thread has ended by an error", thread=name, exc_info=(told.exc_type, error, told.exc_traceback)
        )

    def cannot_be_raised(told: sys.UnraisableHookArgs) -> None:
        error = told.exc_value or told.exc_type()
        exc_info = told.exc_type, error, told.exc_traceback
        uncaught.error("an error could not be raised", where=repr(told.object), exc_info=exc_info)

    sys.excepthook, threading.excepthook, sys.unraisablehook = ends_process, ends_thread, cannot_be_raised
