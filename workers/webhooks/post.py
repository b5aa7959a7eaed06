"""One POST to a webhook: to an address that was checked, within a time, and no further than the answer's head."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from typing import cast

import httpcore

from workers.webhooks.target import Target, TargetRefused, TargetRules

LONGEST_RETRY_AFTER = 86_400
LONGEST_FAILURE = 300
"""Of a sentence that is kept [characters]; what it quotes may be as long as it likes."""


@dataclass(frozen=True)
class PostResult:
    """How a webhook has answered, or why it did not."""

    status: int | None
    failure: str | None
    """A sentence of at most `LONGEST_FAILURE` characters; None if it has taken the message."""
    retry_after: float = 0.0
    """When it wants to be asked again at the earliest [s from now]."""


class CheckedNetwork(httpcore.AsyncNetworkBackend):
    """Connects to addresses that the operator's rules allow, wherever a name leads.

    The name is resolved here, once, and the connection goes to an address of that answer: a name that points elsewhere
    a moment later leads nowhere else.
    """

    def __init__(self, target: Target, rules: TargetRules) -> None:
        self._target, self._rules = target, rules
        self._network = cast(httpcore.AsyncNetworkBackend, httpcore.AnyIOBackend())

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Connect to the first address of `host` that may be connected to.

        Raises:
            TargetRefused: None may.
        """
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        address = self._rules.choose(self._target, [ip_address(where[0]) for *_, where in found])
        return await self._network.connect_tcp(str(address), port, timeout, local_address, socket_options)


async def post(
    url: str, headers: Mapping[str, str], body: bytes, rules: TargetRules, trust: ssl.SSLContext, seconds: float
) -> PostResult:
    """Send a message; redirects are not followed. What goes wrong is told in the result."""
    try:
        target = Target.of(url)
        rules.check(target)
        place = httpcore.URL(scheme=target.scheme, host=target.host, port=target.port, target=target.path)
        fixed = {"Host": target.authority, "Connection": "close"}
        network = CheckedNetwork(target, rules)
        async with asyncio.timeout(seconds), httpcore.AsyncConnectionPool(trust, network_backend=network) as pool:
            # The rest of the answer is of no interest: only its head is read.
            async with pool.stream("POST", place, headers={**fixed, **headers}, content=body) as answer:
                return _judge(answer.status, dict(answer.headers))
    except TargetRefused as error:
        return _failure(str(error))
    except TimeoutError:
        return _failure(f"no answer within {seconds:g} s")
    except (OSError, ValueError, httpcore.NetworkError, httpcore.ProtocolError) as error:
        # ValueError: names that have no encoding, and whatever else is in a URL or an answer that others have written.
        return _failure(f"{type(error).__name__}: {error}")


def _failure(sentence: str) -> PostResult:
    return PostResult(None, sentence[:LONGEST_FAILURE])


def _judge(status: int, headers: Mapping[bytes, bytes]) -> PostResult:
    if 200 <= status < 300:
        return PostResult(status, None)
    why = "redirects are not followed" if 300 <= status < 400 else "not taken"
    retry_after = next((value for name, value in headers.items() if name.lower() == b"retry-after"), b"")
    return PostResult(status, f"{status}: {why}", _seconds(retry_after))


def _seconds(retry_after: bytes) -> float:
    """Read the header's number [s]; a date, which it may be too, is not waited for."""
    if not retry_after.isdigit():
        return 0.0
    # One digit more than the longest time has is more than that, however many follow.
    digits = retry_after.lstrip(b"0")[: len(str(LONGEST_RETRY_AFTER)) + 1]
    return float(min(int(digits or b"0"), LONGEST_RETRY_AFTER))
