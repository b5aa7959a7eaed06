"""Where webhooks may lead."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import socket
import ssl
from collections.abc import Awaitable, Callable
from contextlib import suppress
from datetime import UTC, datetime
from ipaddress import ip_address, ip_network
from typing import Any

import httpcore
import pytest
from standardwebhooks.webhooks import Webhook, WebhookVerificationError

from workers.stores.webhook_store import make_secret
from workers.webhooks.post import post
from workers.webhooks.runner import signed_headers
from workers.webhooks.target import Target, TargetRefused, TargetRules

PUBLIC_ONLY = TargetRules((), ())
LOOPBACK = TargetRules((), (ip_network("127.0.0.0/8"),))
INSIDE = [
    "127.0.0.1",
    "10.1.2.3",
    "172.16.0.1",
    "192.168.1.1",
    "169.254.169.254",
    "100.64.0.1",
    "0.0.0.0",
    "255.255.255.255",
    "224.0.0.1",
    "::1",
    "::",
    "fe80::1",
    "fc00::1",
    "ff02::1",
    "::ffff:127.0.0.1",
    "::ffff:10.0.0.1",
    "64:ff9b::7f00:1",
    "64:ff9b::a00:1",
    "2002:7f00:1::",
    "2002:c0a8:101::",
    "2001:0:a00:1::1",
    "2001:db8::1",
    "64:ff9b:1::7f00:1",
    "64:ff9b:1::808:808",
    "fec0::1",
    "::127.0.0.1",
    "::8.8.8.8",
    "::ffff:0:7f00:1",
    "100::1",
    "5f00::1",
    "4000::1",
]


@pytest.mark.parametrize("address", INSIDE)
def test_no_address_within_reach_of_the_service_alone_may_be_connected_to(address: str) -> None:
    with pytest.raises(TargetRefused):
        PUBLIC_ONLY.choose(Target.of("https://mes.example/hook"), [ip_address(address)])


@pytest.mark.parametrize("address", ["8.8.8.8", "2606:4700:4700::1111", "::ffff:8.8.8.8", "64:ff9b::808:808"])
def test_public_addresses_may_be_connected_to(address: str) -> None:
    target = Target.of("https://mes.example/hook")
    assert PUBLIC_ONLY.choose(target, [ip_address("10.0.0.1"), ip_address(address)]) == ip_address(address)


def test_the_operator_may_allow_a_network_and_only_there_is_no_tls_needed() -> None:
    rules = TargetRules((), (ip_network("10.1.0.0/16"),))
    plain = Target.of("http://mes.factory/hook")
    rules.check(plain)
    assert rules.choose(plain, [ip_address("10.1.2.3")]) == ip_address("10.1.2.3")
    for address in ("10.2.0.1", "8.8.8.8"):
        with pytest.raises(TargetRefused):
            rules.choose(plain, [ip_address(address)])


def test_with_a_list_of_hosts_no_other_is_allowed() -> None:
    rules = TargetRules(("mes.example", "*.plant.example"), ())
    for host in ("mes.example", "MES.example", "a.plant.example"):
        rules.check(Target.of(f"https://{host}/"))
    for host in ("plant.example", "mes.example.evil.example", "evil.example", "evilplant.example"):
        with pytest.raises(TargetRefused):
            rules.check(Target.of(f"https://{host}/"))


@pytest.mark.parametrize(
    "url",
    [
        "",
        "mes.example",
        "ftp://mes.example/",
        "file:///etc/passwd",
        "https://",
        "https:///path",
        "https://user:pw@mes.example/",
        "https://mes.example/#part",
        "https://mes.example:99999/",
        "https://mes.example:x/",
        "https://[::1/",
        "https://mes.example/ a",
        "https://mes.example/\r\nHost: b",
        "https://a\\@b.example/",
        "https://mäs.example/",
        "https://mes.example/" + "a" * 3000,
        "https://a..b/",
        "https://.b/",
        "https://./",
        "https://b../",
        f"https://{'a' * 64}.example/",
        f"https://{'abcdefg.' * 32}example/",
        "https://-a.example/",
        "https://a-.example/",
        "https://a%00b.example/",
        "https://a*b.example/",
        "https://[fe80::1%25eth0]/",
        "https://[fe80::1%eth0]/",
    ],
)
def test_what_is_no_plain_https_url_is_refused(url: str) -> None:
    with pytest.raises(TargetRefused):
        Target.of(url)


@pytest.mark.parametrize(
    "host",
    ["mes", "mes.example.", "m-e-s.example", "mes_1.factory", f"{'a' * 63}.example", "8.8.8.8", "[2606:4700::1]"],
)
def test_names_and_addresses_are_hosts(host: str) -> None:
    assert Target.of(f"https://{host}:8443/hook").host == host.strip("[]")


@pytest.mark.parametrize(
    "url", ["http://mes.example/", "https://127.0.0.1/", "https://[::1]:8443/", "https://10.0.0.1/"]
)
def test_what_can_be_refused_at_once_is(url: str) -> None:
    with pytest.raises(TargetRefused):
        PUBLIC_ONLY.check(Target.of(url))


def posted(monkeypatch: pytest.MonkeyPatch, answers: list[list[str]], rules: TargetRules) -> tuple[Any, list[str], int]:
    """Post to a name that has other addresses each time it is asked for; return the result and who was connected to."""
    connected: list[str] = []
    lookups = iter(answers)
    asked = 0

    async def getaddrinfo(*_: Any, **__: Any) -> list[Any]:
        nonlocal asked
        asked += 1
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 443)) for address in next(lookups)]

    async def connect(_: httpcore.AnyIOBackend, host: str, *__: Any, **___: Any) -> Any:
        connected.append(host)
        raise httpcore.ConnectError("nobody there")

    async def run() -> Any:
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)
        monkeypatch.setattr(httpcore.AnyIOBackend, "connect_tcp", connect)
        return await post("https://mes.example/", {}, b"{}", rules, ssl.create_default_context(), 5.0)

    return asyncio.run(run()), connected, asked


def test_a_name_is_asked_for_once_and_the_address_that_was_checked_is_connected_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result, connected, asked = posted(monkeypatch, [["8.8.8.8"], ["127.0.0.1"]], PUBLIC_ONLY)
    assert (connected, asked) == (["8.8.8.8"], 1)
    assert "nobody there" in result.failure


def test_a_name_that_leads_inside_is_not_connected_to(monkeypatch: pytest.MonkeyPatch) -> None:
    result, connected, _ = posted(monkeypatch, [["127.0.0.1", "10.0.0.1"]], PUBLIC_ONLY)
    assert connected == []
    assert "127.0.0.1" in result.failure


def test_a_failure_is_a_sentence_that_can_be_kept_however_many_addresses_it_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result, _, _ = posted(monkeypatch, [[f"10.0.0.{number}" for number in range(200)]], PUBLIC_ONLY)
    assert result.failure.startswith("mes.example leads to 10.0.0.0, ")
    assert len(result.failure) <= 300


@pytest.mark.parametrize("url", ["https://a..b/", f"https://{'a' * 64}/", "no url"])
def test_a_target_that_was_registered_once_and_is_none_is_told_and_not_raised(url: str) -> None:
    result = asyncio.run(post(url, {}, b"{}", PUBLIC_ONLY, ssl.create_default_context(), 5.0))
    assert result.status is None
    assert result.failure


def test_a_name_that_has_no_encoding_is_told_and_not_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    async def getaddrinfo(*_: Any, **__: Any) -> list[Any]:
        return "a..b".encode("idna").split()

    async def run() -> Any:
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)
        return await post("https://mes.example/", {}, b"{}", PUBLIC_ONLY, ssl.create_default_context(), 5.0)

    assert "UnicodeError" in asyncio.run(run()).failure


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("7", 7.0),
        ("0", 0.0),
        ("0007", 7.0),
        ("0" * 6000 + "7", 7.0),
        ("86400", 86_400.0),
        ("86401", 86_400.0),
        ("9" * 6000, 86_400.0),
        ("-7", 0.0),
        ("Fri, 21 Nov 2036 07:28:00 GMT", 0.0),
    ],
)
def test_a_receiver_may_ask_for_a_day_at_most_in_as_many_digits_as_it_likes(header: str, seconds: float) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n{}")
        writer.write(f"HTTP/1.1 503 Busy\r\nRetry-After: {header}\r\nContent-Length: 0\r\n\r\n".encode())
        await writer.drain()
        writer.close()

    async def run() -> Any:
        async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
            url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
            return await post(url, {}, b"{}", LOOPBACK, ssl.create_default_context(), 5.0)

    result = asyncio.run(run())
    assert (result.status, result.retry_after) == (503, seconds)


def test_a_receiver_is_told_where_and_what_by_the_url_alone() -> None:
    """The request as it goes over the wire: the Host header, the path with its query, and all of the body."""
    got: list[bytes] = []

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        got.append(await reader.readuntil(b"\r\n\r\n"))
        got.append(await reader.readexactly(2))
        writer.write(b"HTTP/1.1 204 Thanks\r\n\r\n")
        await writer.drain()
        writer.close()

    async def run() -> tuple[Any, int]:
        async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            url = f"http://127.0.0.1:{port}/hook?a=b%20c"
            return await post(url, {"X-A": "1"}, b"{}", LOOPBACK, ssl.create_default_context(), 5.0), port

    result, port = asyncio.run(run())
    assert (result.status, result.failure) == (204, None)
    first, *lines = got[0].decode().split("\r\n")
    assert first == "POST /hook?a=b%20c HTTP/1.1"
    assert {"host: 127.0.0.1:" + str(port), "content-length: 2", "connection: close", "x-a: 1"} <= {
        line.lower() for line in lines
    }
    assert got[1] == b"{}"


def posted_to(answer: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]], seconds: float) -> Any:
    """Return the result of a post to a receiver that hangs up only after the sender has."""

    async def run() -> Any:
        gone = asyncio.Event()

        async def answer_and_go(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            with suppress(ConnectionError):
                await answer(reader, writer)
            writer.transport.abort()
            gone.set()

        async with await asyncio.start_server(answer_and_go, "127.0.0.1", 0) as server:
            url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
            result = await post(url, {}, b"{}", LOOPBACK, ssl.create_default_context(), seconds)
            async with asyncio.timeout(20.0):
                await gone.wait()
            return result

    return asyncio.run(run())


def test_an_answer_that_never_ends_is_read_no_further_than_its_head() -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n{}")
        writer.write(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
        while True:
            writer.write(b"10000\r\n" + b"x" * 0x10000 + b"\r\n")
            await writer.drain()

    result = posted_to(answer, 30.0)
    assert (result.status, result.failure) == (200, None)


def test_a_receiver_that_does_not_answer_is_given_up() -> None:
    async def say_nothing(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
        await reader.read()

    result = posted_to(say_nothing, 0.3)
    assert (result.status, result.failure) == (None, "no answer within 0.3 s")


def test_a_message_is_signed_as_the_standard_says() -> None:
    """By its text: HMAC-SHA256 of `id.timestamp.body` with the decoded secret."""
    secret, body, at = make_secret(), '{"outcome":"größer"}', datetime(2026, 11, 22, 6, 0, 0, 900_000, UTC)
    key = base64.b64decode(secret.removeprefix("whsec_"))
    assert len(key) == 32
    signed = hmac.new(key, f"msg_1.{int(at.timestamp())}.{body}".encode(), hashlib.sha256).digest()
    assert signed_headers("msg_1", at, body, [secret]) == {
        "webhook-id": "msg_1",
        "webhook-timestamp": str(int(at.timestamp())),
        "webhook-signature": "v1," + base64.b64encode(signed).decode(),
    }


def test_a_receiver_that_checks_signatures_takes_the_message_and_no_other() -> None:
    secret, body = make_secret(), '{"type":"plan.succeeded"}'
    headers = signed_headers("msg_1", datetime.now(UTC), body, [secret])
    assert Webhook(secret).verify(body, headers) == {"type": "plan.succeeded"}
    with pytest.raises(WebhookVerificationError):
        Webhook(secret).verify(body + " ", headers)
    with pytest.raises(WebhookVerificationError):
        Webhook(make_secret()).verify(body, headers)


def test_while_a_secret_is_replaced_both_verify() -> None:
    old, new = make_secret(), make_secret()
    headers = signed_headers("msg_1", datetime.now(UTC), "{}", [new, old])
    for secret in (old, new):
        assert Webhook(secret).verify(b"{}", headers) == {}
