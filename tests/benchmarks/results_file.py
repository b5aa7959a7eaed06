"""RESULTS.md: parts that are measured at different times, each replaced where it stands."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

NAME = "RESULTS.md"
HEADING = (
    "# Benchmark results\n\nWritten by `make bench`, part by part; each part names the latest commit that changed what "
    "figures depend on, the machine and the load it was measured with. Times are wall clock unless they are called CPU."
)
QUICK = "**A quick run, to see that everything works: these figures mean nothing.**"


def replace_part(file: Path, name: str, text: str, order: Sequence[str], *, quick: bool = False) -> None:
    """Put a part's text in place of its last; the parts stand in the order of their names, unknown ones are dropped."""
    parts = _parts(file.read_text()) if file.exists() else {}
    parts[name] = text
    marked = [f"<!-- part {each} -->\n\n{parts[each]}\n\n<!-- end {each} -->" for each in order if each in parts]
    heading = f"{HEADING}\n\n{QUICK}" if quick else HEADING
    file.write_text("\n\n".join([heading, *marked]) + "\n")


def _parts(text: str) -> dict[str, str]:
    return {
        found["name"]: found["text"].strip()
        for found in re.finditer(r"<!-- part (?P<name>\w+) -->(?P<text>.*?)<!-- end (?P=name) -->", text, re.DOTALL)
    }
