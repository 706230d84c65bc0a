"""Lists in pages: `limit` and `cursor`, and the next page's address in the header `Link`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

from fastapi import Depends, Query, Request, Response

from app.errors import InvalidInputError
from app.limits import limit

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class PagingOptions:
    """How large a page may be."""

    max_items: int = limit(
        1000, "Largest number of items of a page.", chosen="By hand: about a megabyte of builds."
    )
    max_cursor_characters: int = limit(
        100, "Longest cursor.", chosen="By hand: longer than any id that a cursor holds."
    )


OPTIONS = PagingOptions()


@dataclass(frozen=True, slots=True)
class Page:
    """Which part of a list is asked for; without `count` the whole rest."""

    request: Request
    response: Response
    count: int | None
    cursor: str | None

    def of(self, items: Sequence[Item], name: Callable[[Item], object]) -> list[Item]:
        """Return the part of a list, and let `Link` name the next one, if there is one.

        `name` gives what an item is called in a cursor. Raises `InvalidInputError` for a cursor of no item.
        """
        start = 0
        if self.cursor is not None:
            places = (place for place, item in enumerate(items) if str(name(item)) == self.cursor)
            place = next(places, None)
            if place is None:
                raise InvalidInputError("cursor names nothing in this list any more; start at its beginning.")
            start = place + 1
        end = len(items) if self.count is None else start + self.count
        shown = list(items[start:end])
        if end < len(items) and shown:
            following = self.request.url.include_query_params(cursor=name(shown[-1]))
            self.response.headers["Link"] = f'<{following.path}?{following.query}>; rel="next"'
        return shown


def _page(
    request: Request,
    response: Response,
    limit: Annotated[
        int | None, Query(ge=1, le=OPTIONS.max_items, description="Number of items; all of them if left out")
    ] = None,
    cursor: Annotated[
        str | None,
        Query(
            max_length=OPTIONS.max_cursor_characters,
            description="Where to go on: as in the header Link of the page before",
        ),
    ] = None,
) -> Page:
    return Page(request, response, limit, cursor)


Paged = Annotated[Page, Depends(_page)]
