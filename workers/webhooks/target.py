"""Where webhooks may lead: not into the network that the service itself stands in, unless the operator says so."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address
from typing import Self
from urllib.parse import urlsplit

from planners.errors import LiftwrightError

LONGEST_URL = 2000
LONGEST_HOST = 253
LABEL = re.compile(r"[a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9_])?")
"""One part of a name in the DNS (RFC 1035); underscores are found inside of factories."""
DEFAULT_PORTS = {"http": 80, "https": 443}
NAT64 = IPv6Network("64:ff9b::/96")
GLOBAL_UNICAST = IPv6Network("2000::/3")
"""All of IPv6 that is routed on the internet (RFC 4291, IANA's address space registry)."""

Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network


class TargetRefused(LiftwrightError):
    """A webhook leads where none may."""


@dataclass(frozen=True)
class Target:
    """The parts of a webhook's URL."""

    scheme: str
    """http or https."""
    host: str
    port: int
    authority: str
    """As the Host header has it."""
    path: str
    """With the query."""

    @classmethod
    def of(cls, url: str) -> Self:
        """Read a URL.

        Raises:
            TargetRefused: It is none that can be posted to.
        """
        if not (url.isascii() and url.isprintable() and " " not in url and len(url) <= LONGEST_URL):
            raise TargetRefused(f"a webhook's URL has at most {LONGEST_URL} visible ASCII characters")
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise TargetRefused(f"not a URL: {error}") from None
        if parts.scheme not in DEFAULT_PORTS or not parts.hostname:
            raise TargetRefused("a webhook's URL is https://host/path")
        if not _is_host(parts.hostname):
            raise TargetRefused("a webhook's URL has a name or an address as its host")
        if parts.username is not None or parts.fragment or "\\" in url:
            raise TargetRefused("a webhook's URL has no user, password or fragment")
        path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        return cls(parts.scheme, parts.hostname, port or DEFAULT_PORTS[parts.scheme], parts.netloc, path)

    @property
    def tls(self) -> bool:
        """Whether what is sent is encrypted."""
        return self.scheme == "https"


@dataclass(frozen=True)
class TargetRules:
    """What the operator allows."""

    hosts: Sequence[str]
    """Names or patterns (`*.example.com`); none: any."""
    networks: Sequence[Network]
    """Private ones that may be reached, and without TLS."""

    def check(self, target: Target) -> None:
        """Refuse what can be refused without asking for the name's addresses.

        Raises:
            TargetRefused: The host is not on the list, or its address is not allowed, or there is no TLS.
        """
        if self.hosts and not any(fnmatchcase(target.host, pattern.lower()) for pattern in self.hosts):
            raise TargetRefused(f"webhooks may lead to {', '.join(self.hosts)} only")
        if not target.tls and not self.networks:
            raise TargetRefused("webhooks need https")
        try:
            address = ip_address(target.host)
        except ValueError:
            return
        self.choose(target, [address])

    def choose(self, target: Target, addresses: Sequence[Address]) -> Address:
        """Return the first of a name's addresses that may be connected to.

        Raises:
            TargetRefused: None may.
        """
        for address in addresses:
            if any(address in network for network in self.networks) or (target.tls and _is_public(address)):
                return address
        where = ", ".join(map(str, addresses)) or "no address"
        raise TargetRefused(
            f"{target.host} leads to {where}, where webhooks {'' if target.tls else 'without TLS '}may not"
        )


def _is_host(text: str) -> bool:
    if ":" in text:
        return _is_ipv6(text)
    # One dot at the end says that the name is whole.
    return len(text) <= LONGEST_HOST and all(map(LABEL.fullmatch, text.removesuffix(".").split(".")))


def _is_ipv6(text: str) -> bool:
    try:
        # A zone is a matter of this machine alone.
        return IPv6Address(text).scope_id is None
    except ValueError:
        return False


def _is_public(address: Address) -> bool:
    if isinstance(address, IPv4Address):
        return address.is_global and not address.is_multicast
    inner = [address.ipv4_mapped, address.sixtofour, *(address.teredo or ())]
    if address in NAT64:
        inner.append(IPv4Address(int(address) & 0xFFFFFFFF))
    if not all(_is_public(part) for part in inner if part is not None):
        return False
    if address.ipv4_mapped is not None or address in NAT64:
        return True
    # What the language knows as global is more: translated, site-local and IPv4-compatible addresses, too.
    return address in GLOBAL_UNICAST and address.is_global
