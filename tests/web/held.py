"""Requests of a page that are held back, so that their answers come after what the person did next."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from tests.server import wait_for


@dataclass(slots=True)
class Held:
    """The requests of a method that are held back, in their order."""

    page: Any
    method: str
    routes: list[Any] = field(default_factory=list)

    def take(self, route: Any) -> None:
        """Hold a request back, or let it go on if it is of another method."""
        if route.request.method == self.method:
            self.routes.append(route)
        else:
            route.continue_()

    def wait(self) -> None:
        """Wait until a request is held."""
        wait_for(lambda: self.page.wait_for_timeout(20) or self.routes)

    def release(self) -> None:
        """Let the first of them go on, and wait until the page has had its answer."""
        self.wait()
        route = self.routes.pop(0)
        with self.page.expect_event("requestfinished", lambda request: request == route.request):
            route.continue_()
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")


@contextmanager
def held_back(page: Any, pattern: str, method: str = "GET") -> Iterator[Held]:
    """Hold back what a page asks of an address; in the end what is still held goes on."""
    held = Held(page, method)

    def take(route: Any) -> None:  # Playwright marks its handlers, which a method doesn't allow.
        held.take(route)

    page.route(pattern, take)
    yield held
    held.method = ""
    for route in held.routes:
        route.continue_()
    page.unroute(pattern)
