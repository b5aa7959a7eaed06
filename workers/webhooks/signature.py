"""Standard Webhooks: how a message is signed, so that its receiver knows who sent it, when, and that it is whole."""

from __future__ import annotations

import base64
import hashlib
import hmac
from collections.abc import Sequence

from workers.stores.webhook_store import SECRET_PREFIX


def signed_headers(message_id: str, at_seconds: int, body: bytes, secret_texts: Sequence[str]) -> dict[str, str]:
    """Return the headers of a message; while a secret is being replaced there is a signature with each.

    Args:
        message_id: the same at every try, so that the receiver can tell a repeat.
        at_seconds: when it is sent [s since 1970, UTC].
        body: the bytes that are sent.
        secret_texts: as `make_secret` makes them.
    """
    signed = f"{message_id}.{at_seconds}.".encode() + body
    return {
        "webhook-id": message_id,
        "webhook-timestamp": str(at_seconds),
        "webhook-signature": " ".join(_signature(signed, text) for text in secret_texts),
    }


def _signature(signed: bytes, secret_text: str) -> str:
    key = base64.b64decode(secret_text.removeprefix(SECRET_PREFIX))
    return "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
