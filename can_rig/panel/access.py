"""Who may look and who may touch: a token for each, and the exact names of this server.

A page elsewhere reaches the loopback interface too, through the browser of whoever looks at it. It
does not know the token; it cannot give another Origin than its own; and where it lets its own name
point to 127.0.0.1 (DNS rebinding), the Host is that name.
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

    ``control`` is for who may touch, ``view`` for who may look only.
    """

    port: int
    control: str = field(default_factory=_token)
    view: str = field(default_factory=_token)

    def url(self, token: str) -> str:
        """Where the page is for who has ``token``."""
        return f"http://{NAMES[0]}:{self.port}/{token}/"

    def may_touch(self, token: str) -> bool | None:
        """Whether who has ``token`` may touch; None: may not even look."""
        if hmac.compare_digest(token.encode(), self.control.encode()):
            return True
        if hmac.compare_digest(token.encode(), self.view.encode()):
            return False
        return None

    def is_own_host(self, host: str | None) -> bool:
        """Whether a request's Host is this server under one of its own names."""
        return host in self._names()

    def is_own_origin(self, origin: str | None) -> bool:
        """Whether a request comes from a page of this server; a socket always says its Origin."""
        return origin in {f"http://{name}" for name in self._names()}

    def _names(self) -> set[str]:
        """Of this server, as a browser says them: without the port that http has anyway."""
        port = "" if self.port == HTTP_PORT else f":{self.port}"
        return {f"{name}{port}" for name in NAMES}
