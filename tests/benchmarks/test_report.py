"""The benchmarks can be run, and their report has what is promised. No figure is asserted."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.results_file import replace_part

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {
    "Plate lifts: planning": (
        "Aimed at and reached",
        "Tasks, spec to certified plan",
        "Processes and the running service",
        "Table III: building the graph",
        "Table IV: searching the graph",
        "What is ours, and what it changes",
        "The paper's own method on this machine (extrapolated)",
        "How cost grows",
    ),
    "Plate lifts: random": (
        "Aimed at and reached",
        "Random lifts",
        "What helps where there is no plan",
        "Not found, and wrongly so",
        "Lifts that are not solved",
    ),
    "Plate lifts: simulated": (
        "Aimed at and reached",
        "What the controller is worth",
        "Fig. 12 and 13: forces while lifting",
    ),
    "Plate lifts: lifters of all speeds": ("Aimed at and reached", "Lifters that can be followed"),
    "Plate lifts: what a reserve is worth": ("Aimed at and reached", "What the reserve is worth"),
    "Plate lifts: studies": ("Aimed at and reached", "Three models of the lifter", "Where the cup may sit"),
    "The suction tool": (
        "Aimed at and reached",
        "Random layouts",
        "Table I: planning by object and round",
        "Table II: the long tool and the short one",
        "Handover databases, cold and warm",
        "Quality of motion",
    ),
    "The shipped cells": (
        "Aimed at and reached",
        "Random tasks by cell",
        "Tasks of cells that are not solved",
        "Plans of random tasks in physics",
    ),
    "Perception": (
        "Aimed at and reached",
        "Boards of markers",
        "Objects on the table",
        "Uncertainties",
        "The largest scans",
    ),
    "Kernels": ("Aimed at and reached", "Beside other libraries", "Kinematics"),
    "Beside what a user would pick instead": (
        "Aimed at and reached",
        "Ours beside each",
        "Where we lose",
        "What could not be measured",
        "How each was used, and how it fared",
    ),
    "The service: under load": ("Aimed at and reached",),
    "The service: bad input": ("Aimed at and reached",),
    "The service: killed at random": ("Aimed at and reached",),
    "The service: one owner's many jobs and another's one": (
        "Aimed at and reached",
        "One owner's many jobs and another's one",
    ),
    "The service: many workers on one database": (
        "Aimed at and reached",
        "What they ask, and what it costs",
        "Statements a second of each worker, by kind",
        "The first bottleneck, and a thousand workers",
    ),
    "The service: days of jobs": ("Aimed at and reached", "Memory and database"),
    "The service: a fleet in containers": ("Aimed at and reached",),
}


@pytest.mark.slow
def test_a_quick_run_writes_a_well_formed_report_with_all_sections_and_pictures(tmp_path):
    words = [sys.executable, "-m", "tests.benchmarks", "--quick", "--out", str(tmp_path)]
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    text = (tmp_path / "RESULTS.md").read_text()
    headings = [
        heading for part, sections in SECTIONS.items() for heading in (f"## {part}", *(f"### {s}" for s in sections))
    ]
    assert re.findall(r"^###? .*$", text, re.MULTILINE) == headings
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert (tmp_path / picture).read_text().lstrip().startswith("<?xml")
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1, "all rows of a table are as wide as its head"
    assert os.uname().nodename not in text
    assert str(ROOT) not in text


def test_a_part_takes_the_place_of_its_last_and_leaves_the_others(tmp_path):
    file, order = tmp_path / "RESULTS.md", ["one", "two", "three"]
    for name, text in (("three", "last"), ("one", "first"), ("two", "old"), ("two", "new")):
        replace_part(file, name, text, order)
    written = file.read_text()
    assert [word for word in written.split() if word in ("first", "old", "new", "last")] == ["first", "new", "last"]
    replace_part(file, "two", "new", order)
    assert file.read_text() == written
