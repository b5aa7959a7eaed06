"""The URScript subset, read into Python generators that give the controller its turn once a control cycle.

Values are copied when they are assigned, as in URScript: lists are tuples here. A variable without a qualifier is the
global of that name if there is one, else local to its function; functions do not see each other's locals.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator
from dataclasses import dataclass, field

from .lexer import Word, words_of

Program = Generator[None, None, None]
"""Runs until the control cycle ends each time it is resumed."""
SPIN_LIMIT = 100_000
"""Rounds of loops in one control cycle before a program counts as stuck."""
_COMPARISONS = ("==", "!=", "<", ">", "<=", ">=")


class ProgramFault(Exception):
    """A program did what it must not while it ran; it ends there."""


class Pose(tuple[float, ...]):
    """`p[x, y, z, rx, ry, rz]`: metres and a rotation vector."""

    __slots__ = ()


@dataclass
class _Function:
    name: str
    parameters: list[str]
    locals: set[str] = field(default_factory=set)
    body: list[str] = field(default_factory=list)


def translate(script: str, intrinsics: object) -> tuple[str, Callable[[], Program]]:
    """Return a script's name and what starts it.

    Args:
        script: one `def name(): … end`.
        intrinsics: whose public methods are the built-in functions; those that are generators take control cycles.

    Raises:
        ScriptRefused: it is not in the subset: a word, a form, an unknown name, or a call that does not fit.
    """
    translator = _Translator(words_of(script), intrinsics)
    name = translator.program()
    aid = _Aid()
    space: dict[str, object] = {"I": intrinsics, "G": {}, "pose": Pose, "aid": aid}
    exec(compile(translator.source(), f"<{name}>", "exec"), space)
    start: Callable[[], Program] = space[f"f_{name}"]  # type: ignore[assignment]

    def program() -> Program:
        for _ in start():
            aid.rounds = 0
            yield

    return name, program


class _Aid:
    """What translated code needs that Python says otherwise."""

    def __init__(self) -> None:
        self.rounds = 0
        """Of loops in this control cycle."""

    def spin(self) -> None:
        self.rounds += 1
        if self.rounds > SPIN_LIMIT:
            raise ProgramFault("a loop goes round without giving the controller its turn")

    def at(self, values: tuple[object, ...], index: object) -> object:
        # Most of all that a program does.
        if type(index) is int and isinstance(values, tuple) and 0 <= index < len(values):
            return values[index]
        return values[self._place(values, index)]

    def put(self, values: tuple[object, ...], index: object, value: object) -> tuple[object, ...]:
        place = self._place(values, index)
        return type(values)((*values[:place], value, *values[place + 1 :]))

    def truth(self, value: object) -> bool:
        if not isinstance(value, bool):
            raise ProgramFault(f"{value!r} is neither True nor False")
        return value

    @staticmethod
    def _place(values: object, index: object) -> int:
        if not isinstance(values, tuple) or isinstance(index, bool) or not isinstance(index, int):
            raise ProgramFault("an index is a whole number, of a list")
        if not 0 <= index < len(values):
            raise ProgramFault(f"index {index} of a list of {len(values)}")
        return index


class _Translator:
    def __init__(self, words: list[Word], intrinsics: object) -> None:
        self._words, self._at = words, 0
        self._intrinsics = intrinsics
        self._functions: dict[str, _Function] = {}
        self._globals: set[str] = {
            words[i + 1].text for i, word in enumerate(words) if word.text == "global" and word.kind == "keyword"
        }
        self._arity = self._declared()
        self._scope: list[_Function] = []

    def source(self) -> str:
        return "\n".join(line for function in self._functions.values() for line in function.body)

    def program(self) -> str:
        while self._next.kind == "newline":
            self._take()
        name = self._function(0)
        while self._next.kind == "newline":
            self._take()
        if self._next.kind != "end":
            raise self._next.refuse("a script is one def … end")
        if self._functions[name].parameters:
            raise self._words[0].refuse("a program takes no arguments")
        return name

    # Words

    @property
    def _next(self) -> Word:
        return self._words[self._at]

    def _take(self, text: str | None = None, kind: str | None = None) -> Word:
        word = self._next
        if (text is not None and (word.text != text or word.kind == "string")) or (kind and word.kind != kind):
            raise word.refuse(f"{text or kind} is expected here, not {word.text.strip() or 'the end of the line'!r}")
        self._at += 1
        return word

    def _is(self, *texts: str) -> bool:
        return self._next.kind in ("sign", "keyword") and self._next.text in texts

    def _declared(self) -> dict[str, int]:
        """Return every function with its number of parameters: they may be called before they are written."""
        found: dict[str, int] = {}
        for i, word in enumerate(self._words):
            if word.kind == "keyword" and word.text == "def":
                texts: list[str] = []
                for following in self._words[i + 3 :]:
                    if following.text == ")" or following.kind == "newline":
                        break
                    texts.append(following.text)
                found[self._words[i + 1].text] = len([text for text in texts if text != ","])
        return found

    # Statements

    def _function(self, depth: int) -> str:
        self._take("def")
        name = self._take(kind="name")
        if name.text in self._functions or self._intrinsic(name.text):
            raise name.refuse(f"there is a function {name.text} already")
        self._take("(")
        parameters: list[str] = []
        while not self._is(")"):
            if parameters:
                self._take(",")
            parameters.append(self._take(kind="name").text)
        self._take(")")
        self._take(":")
        function = _Function(name.text, parameters, set(parameters))
        self._functions[name.text] = function
        self._scope.append(function)
        lines = self._block(1)
        self._scope.pop()
        self._take("end")
        self._take(kind="newline")
        heads = ", ".join(f"v_{parameter}" for parameter in parameters)
        # The unreachable `yield` makes a generator of a function that never waits.
        function.body = [f"def f_{name.text}({heads}):", *lines, "    return None", "    yield"]
        return name.text

    def _block(self, depth: int) -> list[str]:
        self._take(kind="newline")
        lines: list[str] = []
        while not self._is("end", "elif", "else"):
            if self._next.kind == "end":
                raise self._next.refuse("`end` is missing")
            lines += self._statement(depth)
        return lines or ["    " * depth + "pass"]

    def _statement(self, depth: int) -> list[str]:
        indent = "    " * depth
        if self._is("def"):
            self._function(depth)
            return []
        if self._is("while"):
            self._take()
            condition = self._expression()
            self._take(":")
            body = self._block(depth + 1)
            self._take("end")
            self._take(kind="newline")
            return [f"{indent}while aid.truth({condition}):", f"{indent}    aid.spin()", *body]
        if self._is("if"):
            return self._choice(depth)
        line = self._simple()
        self._take(kind="newline")
        return [indent + line]

    def _choice(self, depth: int) -> list[str]:
        indent, lines, word = "    " * depth, [], "if"
        while True:
            self._take(word)
            head = "else:" if word == "else" else f"{word} aid.truth({self._expression()}):"
            self._take(":")
            lines += [indent + head, *self._block(depth + 1)]
            if word == "else" or self._is("end"):
                break
            word = self._next.text
        self._take("end")
        self._take(kind="newline")
        return lines

    def _simple(self) -> str:
        word = self._next
        if self._is("break", "continue", "pass"):
            return self._take().text
        if self._is("return"):
            self._take()
            return "return" if self._next.kind == "newline" else f"return {self._expression()}"
        if self._is("global", "local"):
            qualifier = self._take().text
            name = self._take(kind="name")
            self._take("=")
            return f"{self._target(name, qualifier)} = {self._expression()}"
        following = self._words[self._at + 1]
        if word.kind == "name" and following.text == "=" and following.kind == "sign":
            self._take()
            self._take()
            value = self._expression()
            return f"{self._target(word, None)} = {value}"
        if word.kind == "name" and following.text == "[" and word.text != "p":
            return self._element()
        if word.kind == "name" and following.text == "(":
            return self._expression()
        if word.text == "halt":
            self._take()
            return "(yield from I.halt())"
        raise word.refuse(f"{word.text!r} begins no statement of the subset")

    def _element(self) -> str:
        name = self._take()
        variable = self._variable(name)
        self._take("[")
        index = self._expression()
        self._take("]")
        self._take("=")
        return f"{variable} = aid.put({variable}, {index}, {self._expression()})"

    def _target(self, name: Word, qualifier: str | None) -> str:
        if name.text in self._arity or self._intrinsic(name.text):
            raise name.refuse(f"{name.text} is a function")
        function = self._scope[-1]
        if qualifier == "local" or (qualifier is None and name.text not in self._globals):
            function.locals.add(name.text)
        return self._variable(name)

    def _variable(self, name: Word) -> str:
        if name.text in self._scope[-1].locals:
            return f"v_{name.text}"
        if name.text in self._globals:
            return f"G[{name.text!r}]"
        raise name.refuse(f"there is no variable {name.text} here")

    # Expressions, from what binds least to what binds most

    def _expression(self) -> str:
        return self._joined(("or",), lambda: self._joined(("and",), self._negation))

    def _joined(self, signs: tuple[str, ...], part: Callable[[], str]) -> str:
        text = part()
        while self._is(*signs):
            sign = self._take().text
            second = part()
            text = (
                f"(aid.truth({text}) {sign} aid.truth({second}))"
                if sign in ("and", "or")
                else f"({text} {sign} {second})"
            )
        return text

    def _negation(self) -> str:
        if self._is("not"):
            self._take()
            return f"(not aid.truth({self._negation()}))"
        text = self._sum()
        if self._is(*_COMPARISONS):
            sign = self._take().text
            text = f"({text} {sign} {self._sum()})"
        return text

    def _sum(self) -> str:
        return self._joined(("+", "-"), lambda: self._joined(("*", "/", "%"), self._signed))

    def _signed(self) -> str:
        if self._is("-"):
            self._take()
            return f"(-{self._signed()})"
        text = self._atom()
        while self._is("["):
            self._take()
            text = f"aid.at({text}, {self._expression()})"
            self._take("]")
        return text

    def _atom(self) -> str:
        word = self._next
        if word.kind in ("number", "string"):
            # 007 is a number in URScript and none in Python.
            return (
                repr(float(word.text) if set(word.text) & set(".eE") else int(word.text))
                if (self._take().kind == "number")
                else repr(word.text[1:-1])
            )
        if self._is("True", "False"):
            return self._take().text
        if self._is("("):
            self._take()
            text = self._expression()
            self._take(")")
            return f"({text})"
        if self._is("["):
            return self._items()
        if word.kind == "name" and word.text == "p" and self._words[self._at + 1].text == "[":
            self._take()
            return f"pose({self._items()})"
        if word.kind == "name":
            self._take()
            return self._call(word) if self._is("(") else self._variable(word)
        raise word.refuse(f"a value is expected here, not {word.text.strip() or 'the end of the line'!r}")

    def _items(self) -> str:
        self._take("[")
        items: list[str] = []
        while not self._is("]"):
            if items:
                self._take(",")
            items.append(self._expression())
        self._take("]")
        return f"({', '.join(items)}{',' if items else ''})"

    def _call(self, name: Word) -> str:
        self._take("(")
        values: list[str] = []
        named: dict[str, str] = {}
        while not self._is(")"):
            if values or named:
                self._take(",")
            if self._next.kind == "name" and self._words[self._at + 1].text == "=":
                keyword = self._take().text
                self._take("=")
                named[keyword] = self._expression()
            else:
                values.append(self._expression())
        self._take(")")
        given = ", ".join([*values, *(f"{key}={value}" for key, value in named.items())])
        if name.text in self._arity:
            if named or len(values) != self._arity[name.text]:
                raise name.refuse(f"{name.text} takes {self._arity[name.text]} arguments")
            return f"(yield from f_{name.text}({given}))"
        method = self._intrinsic(name.text)
        if method is None:
            raise name.refuse(f"there is no function {name.text}")
        try:
            inspect.signature(method).bind(*values, **named)
        except TypeError as error:
            raise name.refuse(f"{name.text}: {error}") from error
        return (
            f"(yield from I.{name.text}({given}))" if inspect.isgeneratorfunction(method) else f"I.{name.text}({given})"
        )

    def _intrinsic(self, name: str) -> Callable[..., object] | None:
        return None if name.startswith("_") else getattr(self._intrinsics, name, None)
