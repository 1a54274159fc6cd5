"""A browser without a window or a network: requests to an application in this process."""

import asyncio

import httpx


class Client:
    """Keeps cookies, as a browser does; answers are whole, so streams must end."""

    def __init__(self, app, base_url: str, *, cookies=None, follow_redirects=True) -> None:
        self._app = app
        self._base_url = base_url
        self._follow = follow_redirects
        self.cookies = httpx.Cookies(cookies)

    def get(self, path: str, headers=None) -> httpx.Response:
        return asyncio.run(self._ask("GET", path, headers))

    def post(self, path: str, headers=None, json=None) -> httpx.Response:
        return asyncio.run(self._ask("POST", path, headers, json=json))

    def request(self, method: str, path: str, headers=None, **more) -> httpx.Response:
        return asyncio.run(self._ask(method, path, headers, **more))

    async def _ask(self, method: str, path: str, headers, **more) -> httpx.Response:
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(self._app),
            base_url=self._base_url,
            cookies=self.cookies,
            follow_redirects=self._follow,
            timeout=60.0,
        ) as client:
            answer = await client.request(method, path, headers=headers, **more)
            self.cookies = client.cookies
            return answer
