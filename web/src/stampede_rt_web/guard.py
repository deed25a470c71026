"""Decides who may see the page: the login token, the check of the Host header, and the headers that limit scripts.

On loopback the page needs no login. A script of another site could reach the page by a name that leads to 127.0.0.1
(DNS rebinding). So the server answers only requests whose Host header is a name of loopback. On other addresses the
page has TLS and a login.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from stampede_rt_runtime.access.audit import AuditLog

COOKIE = "stampede_session"
LOGIN_BYTES_MAX = 1024
TOKEN_CHARACTERS_MIN = 16
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_LOGIN = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Stampede RT: login</title>
<meta name="viewport" content="width=device-width"><link rel="stylesheet" href="/static/style.css"></head>
<body class="login"><form method="post" action="/login"><h1>Stampede RT</h1>
<label>Login token <input name="token" type="password" autofocus autocomplete="current-password"></label>
<button>Log in</button><p>{message}</p></form></body></html>"""


class Guard:
    """ASGI middleware. `token` is None if the page needs no login; `secure` says whether the page has TLS.

    With `loopback_only` it answers only requests whose Host header is a name of loopback.
    """

    def __init__(self, app: ASGIApp, *, token: str | None, secure: bool, loopback_only: bool) -> None:
        self._app = app
        self._token = token
        self._secure = secure
        self._loopback_only = loopback_only
        self._audit = AuditLog()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it. Every answer gets the headers that limit scripts."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]
                message["headers"] = [*message.get("headers", ()), *headers]
            await send(message)

        await (await self._refusal(Request(scope, receive)) or self._app)(scope, receive, with_headers)

    async def _refusal(self, request: Request) -> Response | None:
        """Return the answer for a request that the app must not see; None if the app may answer."""
        if self._loopback_only and not is_loopback_name(request.headers.get("host", "")):
            self._note(request, "page", request.headers.get("host", ""))
            return PlainTextResponse("This page answers only under a name of loopback, such as localhost.", 403)
        if self._token is None:
            return None
        if request.url.path == "/login":
            return await self._login(request, self._token)
        if request.url.path == "/static/style.css" or self._is_logged_in(request, self._token):
            return None
        if request.url.path == "/":
            return RedirectResponse("/login", 303)
        return PlainTextResponse("Log in at /login first.", 401)

    async def _login(self, request: Request, token: str) -> Response:
        if request.method != "POST":
            return HTMLResponse(_LOGIN.format(message=""))
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > LOGIN_BYTES_MAX:
                return PlainTextResponse("This login is too long.", 413)
        given = parse_qs(body.decode(errors="replace")).get("token", [""])[0]
        if not hmac.compare_digest(given.strip().encode(), token.encode()):
            self._note(request, "login", "")
            return HTMLResponse(_LOGIN.format(message="This is not the login token of this page."), 403)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(COOKIE, _session_of(token), httponly=True, samesite="strict", secure=self._secure)
        return answer

    def _note(self, request: Request, verb: str, name: str) -> None:
        """Log a refusal, at most once a second for each address."""
        client = request.client
        self._audit.denied(None, f"{client.host}:{client.port}" if client else "", verb, name)

    def _is_logged_in(self, connection: HTTPConnection, token: str) -> bool:
        return hmac.compare_digest(connection.cookies.get(COOKIE, "").encode(), _session_of(token).encode())


def is_loopback_name(host_header: str) -> bool:
    """Whether a Host header names loopback: "localhost", or an address of loopback, with or without a port."""
    name = host_header.rsplit(":", 1)[0] if not host_header.endswith("]") else host_header
    name = name.strip("[]").lower()
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _session_of(token: str) -> str:
    return hmac.new(token.encode(), b"stampede web session", hashlib.sha256).hexdigest()
