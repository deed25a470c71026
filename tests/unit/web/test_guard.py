"""Unit tests of `stampede_rt_web.guard`: the login, the Host header, and the headers of every answer."""

from __future__ import annotations

from typing import Any

import pytest
from starlette.responses import PlainTextResponse

from stampede_rt_web.guard import COOKIE, HEADERS, Guard, is_loopback_name

TOKEN = "a-token-of-enough-characters"
APP = PlainTextResponse("the page")
FOREIGN = ["evil.example", "127.0.0.1.evil.example:7581", "localhost.evil.example", "", "[", "10.0.0.1"]


async def answer(
    path: str = "/",
    *,
    token: str | None = None,
    loopback_only: bool = True,
    host: str = "localhost:7581",
    cookie: str = "",
    method: str = "GET",
    body: bytes = b"",
) -> tuple[int, dict[str, str]]:
    """Return the status and the headers of the guarded answer."""
    guard = Guard(APP, token=token, secure=True, loopback_only=loopback_only)
    return await ask(guard, path, host=host, cookie=cookie, method=method, body=body)


async def ask(
    guard: Guard, path: str = "/", *, host: str, cookie: str = "", method: str = "GET", body: bytes = b""
) -> tuple[int, dict[str, str]]:
    """Return the status and the headers of the answer of `guard`."""
    scope: dict[str, Any] = {
        "type": "http",
        "method": method,
        "path": path,
        "query_string": b"",
        "headers": [(b"host", host.encode()), (b"cookie", cookie.encode())],
    }
    sent: list[Any] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    await guard(scope, receive, send)
    return sent[0]["status"], {name.decode(): value.decode() for name, value in sent[0]["headers"]}


@pytest.mark.parametrize("host", ["localhost", "localhost:7581", "127.0.0.1:7581", "[::1]:7581", "[::1]", "127.9.9.9"])
async def test_on_loopback_a_request_with_a_loopback_host_name_needs_no_login(host: str) -> None:
    assert (await answer(host=host))[0] == 200


@pytest.mark.parametrize("host", FOREIGN)
async def test_a_name_of_another_site_is_refused_on_loopback(host: str) -> None:
    assert not is_loopback_name(host)
    assert (await answer(host=host))[0] == 403


async def test_every_response_has_the_headers_that_limit_scripts_even_a_refusal() -> None:
    for host in ("localhost", "evil.example"):
        _, headers = await answer(host=host)
        assert {name.lower(): value for name, value in HEADERS.items()}.items() <= headers.items()


async def test_without_a_login_a_page_with_a_token_shows_only_the_login() -> None:
    assert (await answer(token=TOKEN))[0] == 303
    assert (await answer("/api/overview", token=TOKEN))[0] == 401
    assert (await answer("/login", token=TOKEN))[0] == 200


async def test_the_right_token_gives_a_session_and_a_wrong_one_none() -> None:
    status, headers = await answer("/login", token=TOKEN, method="POST", body=f"token={TOKEN}".encode())
    assert status == 303
    attributes = {part.strip().lower() for part in headers["set-cookie"].split(";")}
    assert {"httponly", "samesite=strict", "secure"} <= attributes
    session = headers["set-cookie"].split(";")[0]
    assert TOKEN not in session
    assert (await answer("/api/overview", token=TOKEN, cookie=session))[0] == 200
    status, headers = await answer("/login", token=TOKEN, method="POST", body=b"token=%FFwrong")
    assert (status, "set-cookie" in headers) == (403, False)
    assert (await answer("/", token=TOKEN, cookie=f"{COOKIE}=guess"))[0] == 303


async def test_a_login_that_is_too_long_is_refused() -> None:
    assert (await answer("/login", token=TOKEN, method="POST", body=b"token=" + b"x" * 2000))[0] == 413


async def test_beyond_loopback_any_host_name_is_accepted_because_a_login_is_needed() -> None:
    assert (await answer("/login", token=TOKEN, loopback_only=False, host="rig.example"))[0] == 200


async def test_refused_requests_and_logins_are_logged_at_most_once_a_second(caplog: pytest.LogCaptureFixture) -> None:
    guard = Guard(APP, token=TOKEN, secure=True, loopback_only=True)
    for _ in range(3):
        await ask(guard, host="evil.example")
    (line,) = caplog.records
    assert (vars(line)["event"], vars(line)["verb"], vars(line)["thing"]) == ("access_denied", "page", "evil.example")
    caplog.clear()
    await answer("/login", method="POST", body=b"token=wrong", token=TOKEN)
    assert [vars(one)["verb"] for one in caplog.records] == ["login"]
