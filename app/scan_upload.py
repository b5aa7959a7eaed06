"""From a form with a scan to its description and its files."""

from __future__ import annotations

from anyio import to_thread
from starlette.requests import Request

from app.errors import BadScan, NotScanMedia
from app.form import FORM, content_type, form_parts
from app.intake import Patience, read_limited
from planners.perception.perceive import PARTS

DESCRIPTION = "scan"


async def read_scan_form(request: Request, limit: int, patience: Patience) -> tuple[bytes, dict[str, bytes]]:
    """Return the part `scan`, and the other parts by their names.

    Raises:
        NotScanMedia: It is declared as something else than a form.
        BadScan, BadUpload: The form does not hold one `scan` and each file once.
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes.
        BodyStalled: Its sender is slower than `patience` allows.
    """
    declared = request.headers.get("content-type")
    header = content_type(declared)
    if declared is None or header.get_content_type() != FORM:
        raise NotScanMedia(declared)
    parts = await to_thread.run_sync(form_parts, await read_limited(request, limit, patience), header)
    known = (DESCRIPTION, *PARTS)
    names = [part.name for part in parts]
    for name in names:
        if name not in known:
            raise BadScan(f"the form has a part {name[:100]!r}; it can have {', '.join(known)}")
        if names.count(name) > 1:
            raise BadScan(f"the form has the part {name} twice")
    files = {part.name: part.content for part in parts}
    if DESCRIPTION not in files:
        raise BadScan(f"the form has no part {DESCRIPTION}, which describes the others")
    return files.pop(DESCRIPTION), files
