"""One POST to a webhook: to an address that was checked, within a time, and no further than the answer's head."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import ip_address

import h11

from workers.webhooks.target import Address, Target, TargetRefused, TargetRules

READ_BYTES = 4096
LARGEST_HEAD_BYTES = 16_384
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


async def post(
    url: str, headers: Mapping[str, str], body: bytes, rules: TargetRules, trust: ssl.SSLContext, seconds: float
) -> PostResult:
    """Send a message; redirects are not followed. What goes wrong is told in the result.

    The name is resolved once, and the connection goes to an address of that answer that `rules` allow: a name that
    points elsewhere a moment later leads nowhere else.
    """
    try:
        target = Target.of(url)
        rules.check(target)
        async with asyncio.timeout(seconds):
            address = rules.choose(target, await _addresses(target))
            return _judge(await _exchange(target, address, headers, body, trust))
    except TargetRefused as error:
        return _failure(str(error))
    except TimeoutError:
        return _failure(f"no answer within {seconds:g} s")
    except (OSError, ValueError, h11.ProtocolError) as error:
        # ValueError: names that have no encoding, and whatever else is in a URL or an answer that others have written.
        return _failure(f"{type(error).__name__}: {error}")


def _failure(sentence: str) -> PostResult:
    return PostResult(None, sentence[:LONGEST_FAILURE])


async def _addresses(target: Target) -> list[Address]:
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(target.host, target.port, type=socket.SOCK_STREAM)
    return [ip_address(where[0]) for *_, where in found]


async def _exchange(
    target: Target, address: Address, headers: Mapping[str, str], body: bytes, trust: ssl.SSLContext
) -> h11.Response:
    tls = {"ssl": trust, "server_hostname": target.host} if target.tls else {}
    reader, writer = await asyncio.open_connection(str(address), target.port, **tls)
    try:
        connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=LARGEST_HEAD_BYTES)
        fixed = {"Host": target.authority, "Content-Length": str(len(body)), "Connection": "close"}
        request = h11.Request(method="POST", target=target.path, headers=list({**fixed, **headers}.items()))
        for event in (request, h11.Data(data=body), h11.EndOfMessage()):
            writer.write(connection.send(event) or b"")
        await writer.drain()
        while True:
            event = connection.next_event()
            if isinstance(event, h11.Response):
                return event
            if event is h11.NEED_DATA:
                connection.receive_data(await reader.read(READ_BYTES))
    finally:
        # The rest of the answer is of no interest, nor is a polite end.
        writer.transport.abort()


def _judge(response: h11.Response) -> PostResult:
    status = response.status_code
    if 200 <= status < 300:
        return PostResult(status, None)
    why = "redirects are not followed" if 300 <= status < 400 else "not taken"
    return PostResult(status, f"{status}: {why}", _seconds(dict(response.headers).get(b"retry-after", b"")))


def _seconds(retry_after: bytes) -> float:
    """Read the header's number [s]; a date, which it may be too, is not waited for."""
    if not retry_after.isdigit():
        return 0.0
    # One digit more than the longest time has is more than that, however many follow.
    digits = retry_after.lstrip(b"0")[: len(str(LONGEST_RETRY_AFTER)) + 1]
    return float(min(int(digits or b"0"), LONGEST_RETRY_AFTER))
