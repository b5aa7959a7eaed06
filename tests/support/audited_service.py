"""`liftwright` under an audit hook: after SIGUSR1, what it writes elsewhere, connects to or starts is noted."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

NOTES = "LIFTWRIGHT_AUDIT_NOTES"
"""Environment variable that names the file."""
STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "ctypes.dlopen")
FETCHES = ("socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "urllib.Request", "ftplib.connect")
CHANGES = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate", "shutil.move")
IN_FOLDER = {"os.remove": 1, "os.rmdir": 1, "os.mkdir": 2, "os.rename": 2}
"""Which argument is the open folder that a relative path is in, -1: the current one."""
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def watch(data_dir: Path, notes: int) -> None:
    """Install the hook; it cannot be taken away again."""
    armed, home = False, str(data_dir.resolve())

    def arm(*_: object) -> None:
        nonlocal armed
        armed = True

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if armed and _forbidden(event, arguments, home):
            os.write(notes, f"{event} {arguments!r:.300}\n".encode())

    signal.signal(signal.SIGUSR1, arm)
    sys.addaudithook(hook)


def _forbidden(event: str, arguments: tuple[Any, ...], home: str) -> bool:
    if event in STARTS or event in FETCHES:
        return True
    if event in CHANGES:
        folder = arguments[IN_FOLDER[event]] if event in IN_FOLDER else -1
        return _outside(arguments[0], home, "" if folder == -1 else f"/proc/self/fd/{folder}")
    # SQLite opens its files by itself; what Python opens is told here.
    return event == "open" and bool((arguments[2] or 0) & WRITING) and _outside(arguments[0], home)


def _outside(path: object, home: str, folder: str = "") -> bool:
    if isinstance(path, bytes):
        path = os.fsdecode(path)
    if not isinstance(path, str) or path == os.devnull:
        return False
    return not os.path.realpath(os.path.join(folder, path)).startswith(home)


if __name__ == "__main__":
    words = sys.argv[1:]
    file = os.open(os.environ[NOTES], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    watch(Path(words[words.index("--data-dir") + 1]), file)
    from app.cli.main import main

    sys.exit(main(words))
