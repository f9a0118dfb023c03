"""Access to the panel: tokens for viewing and control, and the exact names of this server.

The browser of a viewer lets pages of foreign sites reach the loopback interface too. A foreign page
does not know the token and cannot forge the Origin header. If a foreign site points a domain name
of its own to 127.0.0.1 (DNS rebinding), the Host header carries the foreign name.
"""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field
from typing import Final

TOKEN_BYTES: Final = 24
NAMES: Final = ("127.0.0.1", "localhost")
HTTP_PORT: Final = 80


def _token() -> str:
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True)
class Access:
    """The tokens of one start of the panel.

    ``control`` permits viewing and commands, ``view`` permits viewing only.
    """

    port: int
    control: str = field(default_factory=_token)
    view: str = field(default_factory=_token)

    def url(self, token: str) -> str:
        """The address of the page with ``token``."""
        return f"http://{NAMES[0]}:{self.port}/{token}/"

    def may_touch(self, token: str) -> bool | None:
        """Whether who has ``token`` may touch; None: may not even look."""
        if hmac.compare_digest(token.encode(), self.control.encode()):
            return True
        if hmac.compare_digest(token.encode(), self.view.encode()):
            return False
        return None

    def is_own_host(self, host: str | None) -> bool:
        """Whether a request's Host header names this server."""
        return host in self._names()

    def is_own_origin(self, origin: str | None) -> bool:
        """Whether a request's Origin is a page of this server; web sockets always send Origin."""
        return origin in {f"http://{name}" for name in self._names()}

    def _names(self) -> set[str]:
        """The server's names in a browser's spelling: without port 80, the default of http."""
        port = "" if self.port == HTTP_PORT else f":{self.port}"
        return {f"{name}{port}" for name in NAMES}
