"""YAML says what JSON could say, member by member, or is refused with its line."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from planners.contract.strict_yaml import MOST_NODES, NotYaml, parse_yaml

WORDS = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs")), max_size=12)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**20), 10**20)
    | st.floats(allow_nan=False, allow_infinity=False)
    | WORDS
    | st.sampled_from(["no", "on", "yes", "12", "1e3", "null", "~", "2020-01-01", "0x1f", "1:30"])
)
DATA = st.recursive(SCALARS, lambda part: st.lists(part, max_size=4) | st.dictionaries(WORDS, part, max_size=4))


@given(DATA)
def test_what_another_library_writes_is_read_as_it_was(data: Any) -> None:
    # In quotes with tags: what is written plain means other things to that library, which reads YAML 1.1.
    assert parse_yaml(yaml.safe_dump(data, allow_unicode=True, default_style='"').encode())[0] == data


@given(st.dictionaries(st.from_regex(r"[a-z]{1,5}", fullmatch=True), SCALARS, max_size=5))
def test_json_in_lines_is_read_as_json(data: dict[str, Any]) -> None:
    assert parse_yaml(json.dumps(data, indent=1).encode())[0] == data


@pytest.mark.parametrize("text", ["1e-3", "-3e+2", ".5", "5.", "12", "-0.25", "1.5E2"])
def test_what_reads_as_a_number_is_one(text: str) -> None:
    assert parse_yaml(f"mass: {text}".encode())[0] == {"mass": float(text)}


@pytest.mark.parametrize("text", ["no", "off", "Yes", "2020-01-01", "0x1f", "1_000", "1:30", "on"])
def test_what_is_no_scalar_of_yaml_1_2_is_a_string(text: str) -> None:
    assert parse_yaml(f"name: {text}".encode())[0] == {"name": text}


def test_each_member_has_the_line_in_which_it_stands() -> None:
    text = "# a task\nkind: plate_lift\n\nobstacles:\n  - name: post\n    pose: [0, 1,\n      2]\n  - {name: a/b}\n"
    data, lines = parse_yaml(text.encode())
    assert data == {"kind": "plate_lift", "obstacles": [{"name": "post", "pose": [0, 1, 2]}, {"name": "a/b"}]}
    wanted = {"/kind": "kind:", "/obstacles": "obstacles:", "/obstacles/0/name": "post", "/obstacles/0/pose": "pose:"}
    wanted |= {"/obstacles/0/pose/2": "2]", "/obstacles/1/name": "a/b"}
    for pointer, words in wanted.items():
        assert words in text.splitlines()[lines[pointer] - 1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"a: 1\nb: 2\na: 3", "line 3: the key 'a' stands twice"),
        (b"a: 1\n2: b", "line 2: a key is no string"),
        (b"a:\n  - !!python/object/apply:os.system [ls]", "line 2: the tag 'python/object/apply:os.system' is not"),
        (b'a: "\\ud800"', "line 1: a string has half of a surrogate pair"),
        (b"a: !!int x", "line 1: the tag 'int' is not"),
        (b"a: 1\nb: &x [1, *x]", "line 2: an alias stands for what it is itself part of"),
        (b"a: [1,\nb: 2", "line 2"),
        (b"a: 1\n---\nb: 2", "another document"),
        (b"\xff\xfe\x00", "not"),
        (b"[" * 5000, "too deeply"),
    ],
)
@pytest.mark.slow
def test_what_is_no_such_yaml_is_refused_with_its_line(text: bytes, said: str) -> None:
    with pytest.raises(NotYaml, match=re.escape(said)):
        parse_yaml(text)


def test_aliases_do_not_make_much_of_little() -> None:
    ways = ["a0: &a0 [x]"] + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12)]
    with pytest.raises(NotYaml, match=f"more than {MOST_NODES} values"):
        parse_yaml("\n".join(ways).encode())
