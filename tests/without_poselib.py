"""A plugin of pytest that hides PoseLib: `python -m pytest -p tests.without_poselib ...`."""

import sys

# Python raises ImportError for a module that is None here.
sys.modules["poselib"] = None  # type: ignore[assignment]
