"""The models that describe images, opened once and shared: extractors by name and the global descriptor."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

from app.errors import ConflictError
from app.vision.faces.detector import FaceDetector, open_face_detector
from app.vision.features import LocalFeatureExtractor
from app.vision.global_descriptor import DEFAULT_MODEL, GlobalDescriptor
from app.vision.learned.lighterglue import LighterGlue
from app.vision.local_features import XFeat, create_extractor


class VisionModels:
    """Opens each model at its first use; safe to share between threads."""

    def __init__(
        self,
        descriptor_path: Path | None = None,
        input_size: tuple[int, int] = (320, 240),
        threads: int = 1,
        face_model: Path | None = None,
    ) -> None:
        self._descriptor_path = descriptor_path or DEFAULT_MODEL
        self._input_size = input_size
        self._threads = threads
        self._face_model = face_model
        self._faces: FaceDetector | None = None
        self._lock = Lock()
        self._extractors: dict[str, LocalFeatureExtractor] = {}
        self._descriptor: GlobalDescriptor | None = None
        self._lighterglue: LighterGlue | None = None
        self._xfeat: XFeat | None = None

    def extractor(self, name: str) -> LocalFeatureExtractor:
        """Return the extractor of that name; raises `InvalidInputError` for an unknown one."""
        if name == "xfeat":
            return self.xfeat
        with self._lock:
            if name not in self._extractors:
                self._extractors[name] = create_extractor(name, self._threads)
            return self._extractors[name]

    @property
    def xfeat(self) -> XFeat:
        """XFeat's extractor, which also describes every cell of a picture."""
        with self._lock:
            if self._xfeat is None:
                self._xfeat = XFeat(threads=self._threads)
            return self._xfeat

    @property
    def global_descriptor(self) -> GlobalDescriptor:
        """The global descriptor."""
        with self._lock:
            if self._descriptor is None:
                self._descriptor = GlobalDescriptor(self._descriptor_path, *self._input_size, self._threads)
            return self._descriptor

    @property
    def lighterglue(self) -> LighterGlue:
        """The matcher of XFeat's features."""
        with self._lock:
            if self._lighterglue is None:
                self._lighterglue = LighterGlue(self._threads)
            return self._lighterglue

    @property
    def faces(self) -> FaceDetector:
        """The detector of faces; raises `InvalidInputError` where there is none."""
        with self._lock:
            if self._faces is None:
                self._faces = open_face_detector(self._face_model)
            return self._faces

    @property
    def descriptor_path(self) -> Path:
        """The file of the global descriptor's model."""
        return self._descriptor_path

    def check_descriptor(self, sha256: str) -> None:
        """Raise `ConflictError` unless a map with this model's checksum can be searched with ours."""
        if sha256 != self.global_descriptor.sha256:
            raise ConflictError(
                "The map was built with another global descriptor model; rebuild it, or set "
                "ROOMFIX_DESCRIPTOR_MODEL to the model it was built with."
            )
