"""The page's files, and logging in."""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Awaitable, Callable
from typing import Final

from aiohttp import web

from panoexec import __version__
from panoexec.web.access import COOKIE, PHOTOS, SESSION_S, Access, LoginRefusedError, User
from panoexec.web.fleet import Fleet
from panoexec.web.headers import PAGE_POLICY, secured
from panoexec.web.protocol import is_mission, is_vehicle
from panoexec.web.static_files import read_static_files

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

USER: Final = web.RequestKey("user", User)
"""Of a request: who asks."""

_FRESH: Final = bool(os.environ.get("PANOEXEC_WEB_ASSETS_FRESH"))
"""Read the page's files at each request: for whoever changes them."""

_OPEN: Final = frozenset({"/login", "/logout", "/register_service"})
"""What needs no session, beside the files of the page, which hold no secret."""

_SAFE: Final = frozenset({"GET", "HEAD"})
_PHOTO: Final = re.compile(r"/missions/[^/]+/images/[^/]+")
_BODY_S: Final = 10.0


class Pages:
    """Answers requests for the page."""

    def __init__(self, *, access: Access, fleet: Fleet, tls: bool) -> None:
        """Describe it.

        Args:
            access: who may do what.
            fleet: has the thumbnails.
            tls: whether browsers come by TLS, so that the cookie is for that alone.
        """
        self._access = access
        self._fleet = fleet
        self._tls = tls
        self._files = read_static_files()

    def add_routes(self, app: web.Application) -> None:
        """Add what is answered here."""
        app.router.add_get("/", self._page)
        app.router.add_get("/v/{vehicle}", self._page)
        app.router.add_get("/assets/{name:.+}", self._asset)
        app.router.add_get("/login", self._login_page)
        app.router.add_post("/login", self._log_in)
        app.router.add_post("/logout", self._log_out)
        app.router.add_get("/register_service", _service)
        app.router.add_get("/thumbnails/{vehicle}/{mission}/{shot}", self._thumbnail)

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what does not come from our own page, or from nobody who may; give every answer its headers."""
        try:
            self._check(request)
            response = await handler(request)
        except web.HTTPException as refused:
            response = web.Response(status=refused.status, text=f"{refused.status}: {refused.reason}\n")
            for name in ("Location", "Retry-After", "Allow"):
                if name in refused.headers:
                    response.headers[name] = refused.headers[name]
        return response if response.prepared else secured(response)

    def _check(self, request: web.Request) -> None:
        acts = request.method not in _SAFE or request.path == "/socket"
        host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
        if not self._access.may_come_from(host=host, origin=origin, acts=acts):
            raise web.HTTPForbidden
        user = self._access.user(request.cookies.get(COOKIE))
        if user is None and request.method in _SAFE and _PHOTO.fullmatch(request.path):
            user = self._access.may_see_photos(request.cookies.get(PHOTOS))
        if user is not None:
            request[USER] = user
        elif request.path not in _OPEN and not request.path.startswith("/assets/"):
            if request.path == "/" or request.path.startswith("/v/"):
                raise web.HTTPSeeOther("/login")
            raise web.HTTPUnauthorized

    async def _page(self, request: web.Request) -> web.StreamResponse:
        vehicle = request.match_info.get("vehicle")
        if vehicle is not None and not is_vehicle(vehicle):
            raise web.HTTPNotFound
        return self._file("index.html", policy=PAGE_POLICY)

    async def _asset(self, request: web.Request) -> web.StreamResponse:
        return self._file(request.match_info["name"], known=request.headers.get("If-None-Match", ""))

    def _file(self, name: str, *, known: str = "", policy: str = "") -> web.Response:
        if _FRESH:
            self._files = read_static_files()
        file = self._files.get(name)
        if file is None:
            raise web.HTTPNotFound
        headers = {"ETag": file.etag, "Cache-Control": "no-cache"}
        if policy:
            headers["Content-Security-Policy"] = policy
        if known == file.etag:
            return web.Response(status=304, headers=headers)
        return web.Response(body=file.content, content_type=file.kind, charset=file.charset, headers=headers)

    async def _thumbnail(self, request: web.Request) -> web.StreamResponse:
        where = request.match_info
        shot = where["shot"]
        if not (is_vehicle(where["vehicle"]) and is_mission(where["mission"]) and shot.isdecimal() and len(shot) <= 6):
            raise web.HTTPNotFound
        jpeg = self._fleet.thumbnail(where["vehicle"], where["mission"], int(shot))
        if jpeg is None:
            raise web.HTTPNotFound
        kept = {"Cache-Control": "private, max-age=86400, immutable"}
        return web.Response(body=jpeg, content_type="image/jpeg", headers=kept)

    # --- logins

    async def _login_page(self, request: web.Request) -> web.StreamResponse:
        if USER in request:
            raise web.HTTPSeeOther("/")
        return self._file("login.html", policy=PAGE_POLICY)

    async def _log_in(self, request: web.Request) -> web.StreamResponse:
        if not self._access.needs_login:
            raise web.HTTPSeeOther("/")
        try:
            async with asyncio.timeout(_BODY_S):
                form = await request.post()
        except (TimeoutError, ValueError) as error:
            raise web.HTTPBadRequest from error
        name, password = form.get("name"), form.get("password")
        if not isinstance(name, str) or not isinstance(password, str) or len(password) > 1_000:
            raise web.HTTPBadRequest
        try:
            token = await self._access.log_in(name.strip(), password, request.remote or "")
        except LoginRefusedError as error:
            raise web.HTTPSeeOther("/login?failed=" + ("wait" if error.too_many else "wrong")) from error
        response = web.Response(status=303, headers={"Location": "/"})
        response.set_cookie(
            COOKIE, token, max_age=int(SESSION_S), path="/", httponly=True, samesite="Strict", secure=self._tls
        )
        photos = self._access.photo_token(token)
        response.set_cookie(
            PHOTOS, photos, max_age=int(SESSION_S), path="/missions", httponly=True, samesite="Lax", secure=self._tls
        )
        return response

    async def _log_out(self, request: web.Request) -> web.StreamResponse:
        self._access.log_out(request.cookies.get(COOKIE))
        response = web.Response(status=303, headers={"Location": "/login"})
        response.del_cookie(COOKIE, path="/", httponly=True, samesite="Strict", secure=self._tls)
        response.del_cookie(PHOTOS, path="/missions", httponly=True, samesite="Lax", secure=self._tls)
        return response


async def _service(request: web.Request) -> web.StreamResponse:
    """What BlueOS shows of a page that it finds on a port."""
    del request
    return web.json_response(
        {
            "name": "panoexec",
            "description": "Complete panoramas: plan, watch and command missions",
            "icon": "mdi-panorama-sphere",
            "company": "panoexec",
            "version": __version__,
            "webpage": "",
            "api": "",
            "new_page": True,
        }
    )
