"""What runs builds: the embedded worker process by default, a distributed queue when scaled out."""

from __future__ import annotations

from typing import Protocol


class BuildRunner(Protocol):
    """Starts and stops with the server."""

    def start(self) -> None:
        """Start to run builds."""
        ...

    def wake(self) -> None:
        """Tell that a build was queued."""
        ...

    def alive(self) -> bool:
        """Return whether builds are being run."""
        ...

    def stop(self) -> None:
        """Stop; a running build is taken up again at the next start."""
        ...


class NoRunner:
    """For servers whose builds are run elsewhere (`roomfix worker`)."""

    def start(self) -> None:
        """Do nothing."""

    def wake(self) -> None:
        """Do nothing: workers look into the queue by themselves."""

    def alive(self) -> bool:
        """Return True: nothing is missing here."""
        return True

    def stop(self) -> None:
        """Do nothing."""
