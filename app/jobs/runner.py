"""The protocol of what runs builds: by default the embedded worker process."""

from __future__ import annotations

from typing import Protocol


class BuildRunner(Protocol):
    """Starts and stops with the server."""

    def start(self) -> None:
        """Start to run builds."""
        ...

    def wake(self) -> None:
        """Be told that a build was queued."""
        ...

    def alive(self) -> bool:
        """Return whether builds are being run."""
        ...

    def stop(self) -> None:
        """Stop; a running build is queued again at the next start."""
        ...


class NoRunner:
    """The runner of servers whose builds are run by another process (`roomfix worker`)."""

    def start(self) -> None:
        """Do nothing."""

    def wake(self) -> None:
        """Do nothing: workers check the queue by themselves."""

    def alive(self) -> bool:
        """Return True: this process needs no worker."""
        return True

    def stop(self) -> None:
        """Do nothing."""
