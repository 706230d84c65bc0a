"""Requests of a page that are held back, so that their answers come after what the person did next."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
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


@dataclass(slots=True)
class HeldAnswers:
    """A page's stream to a real server: what it sends goes on at once, the answers when they are released."""

    page: Any
    frames: list[bytes] = field(default_factory=list)
    hints: list[dict[str, Any]] = field(default_factory=list)
    held: list[str] = field(default_factory=list)
    answered: int = 0
    most_unanswered: int = 0
    holds: bool = True
    socket: Any = None

    @staticmethod
    def of(page: Any) -> HeldAnswers:
        """Stand between a page that isn't opened yet and its streams, of which it has one at a time."""
        answers = HeldAnswers(page)

        def take(socket: Any) -> None:
            answers.socket = socket
            server = socket.connect_to_server()

            def to_server(message: str | bytes) -> None:
                answers.note(message)
                server.send(message)

            def to_page(message: str | bytes) -> None:
                answers.held.append(str(message))
                if not answers.holds:
                    answers.forward()

            socket.on_message(to_server)
            server.on_message(to_page)

        page.route_web_socket(re.compile("/stream$"), take)
        return answers

    @property
    def unanswered(self) -> int:
        """How many frames have no answer yet, as the page knows it."""
        return len(self.frames) - self.answered

    def note(self, message: str | bytes) -> None:
        """Keep what the page sends."""
        if isinstance(message, bytes):
            self.frames.append(message)
            self.most_unanswered = max(self.most_unanswered, self.unanswered)
        else:
            self.hints.append(json.loads(message))

    def forward(self) -> None:
        """Give the page the oldest answer."""
        self.answered += 1
        self.socket.send(self.held.pop(0))

    def release(self) -> None:
        """Wait for an answer, and give it to the page."""
        self.wait_until(lambda: self.held)
        self.forward()

    def let_through(self) -> None:
        """Hold no answers back from now on."""
        self.holds = False
        while self.held:
            self.forward()

    def hold(self) -> None:
        """Hold answers back again."""
        self.holds = True

    def wait_until(self, is_so: Callable[[], object]) -> None:
        """Wait for something while messages come and go."""
        wait_for(lambda: self.page.wait_for_timeout(20) or is_so())
