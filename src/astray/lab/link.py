"""Links that open a level with an agent in the lab, in the format of `page/link.js`."""

import base64
import json
import zlib
from urllib.parse import urlencode

from astray.level import Level

FIELDS = ("grid", "agent", "looks")  # that a level is built from


def link(level: Level, variant: str, agent: str) -> str:
    """Return the part of a link after the page's address; it contains the level itself."""
    told = level.to_json()
    text = json.dumps({name: told[name] for name in FIELDS}, separators=(",", ":"))
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)  # without a head
    packed = base64.urlsafe_b64encode(deflate.compress(text.encode()) + deflate.flush())
    words = {"game": level.game.name, "variant": variant, "agent": agent}
    return f"#{urlencode(words)}&drawn={packed.decode().rstrip('=')}"
