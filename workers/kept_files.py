"""Files that can be made again, kept for whoever asks next: a bounded folder that several processes may share."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

import structlog

log = structlog.get_logger(__name__)


class KeptFiles:
    """A folder of files by name, those that were used last. One that cannot be written costs time, never an answer."""

    def __init__(self, folder: Path, suffix: str, most_bytes: int) -> None:
        """Keep at most `most_bytes` in files that end in `suffix`; 0: nothing."""
        self._folder, self._suffix, self._most_bytes = folder, suffix, most_bytes

    def path(self, name: str) -> Path:
        """Return where a file of a name is, if it is kept."""
        return self._folder / f"{name}{self._suffix}"

    def read(self, name: str) -> bytes | None:
        """Return a file; None: it is not kept, or cannot be read."""
        path = self.path(name)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            log.warning("kept file cannot be read", path=str(path), error=str(error))
            return None
        with suppress(OSError):
            # The time of last use decides which files go.
            path.touch()
        return content

    def keep(self, name: str, content: bytes) -> None:
        """Keep a file. Readers see all of it or nothing."""
        if len(content) > self._most_bytes:
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._write(self.path(name), content)
            self._forget_the_oldest()
        except OSError as error:
            log.warning("file not kept", path=str(self.path(name)), error=str(error))

    def _write(self, path: Path, content: bytes) -> None:
        handle, part = tempfile.mkstemp(dir=self._folder, prefix=".", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            Path(part).replace(path)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise

    def _forget_the_oldest(self) -> None:
        kept: list[tuple[int, int, Path]] = []
        for path in self._folder.glob(f"*{self._suffix}"):
            # Another process may have removed it.
            with suppress(FileNotFoundError):
                told = path.stat()
                kept.append((told.st_mtime_ns, told.st_size, path))
        room = self._most_bytes
        for _, size, path in sorted(kept, reverse=True):
            room -= size
            if room < 0:
                path.unlink(missing_ok=True)
