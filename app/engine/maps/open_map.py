"""An open map: all that a reader of one map version needs, as one value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.retrieval import Retrieval
from app.engine.maps.surroundings import MapSurroundings
from app.engine.maps.vision_models import VisionModels
from app.vision.features import LocalFeatureExtractor
from app.vision.global_descriptor import GlobalDescriptor
from app.vision.images import Rgb
from app.vision.index import GlobalIndex
from app.vision.learned.lighterglue import LighterGlue
from app.vision.local_features import XFeat


@dataclass(frozen=True, slots=True)
class SecondLook:
    """What describes a picture for the map's second features, and matches it with them; opened at its first use."""

    models: VisionModels

    @property
    def extractor(self) -> XFeat:
        """The extractor of the second features."""
        return self.models.xfeat

    @property
    def network(self) -> LighterGlue:
        """The network that matches them."""
        return self.models.lighterglue


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenMap:
    """A map's artefact and index, what is derived from them, and the models that describe pictures for it.

    Immutable, safe to share between threads. `faint_extractor` describes pictures in which `extractor` finds too
    little; None where the method has no such variant. `second_look` matches the map's second features, None where it
    has none.
    """

    artifact: MapArtifact
    index: GlobalIndex
    retrieval: Retrieval
    surroundings: MapSurroundings
    descriptor: GlobalDescriptor
    extractor: LocalFeatureExtractor
    faint_extractor: LocalFeatureExtractor | None
    second_look: SecondLook | None = None

    @staticmethod
    def of(artifact: MapArtifact, index: GlobalIndex, models: VisionModels) -> OpenMap:
        """Return the open map of an artefact and its index.

        Raises `ConflictError` when the map was made with another model of the global descriptor.
        """
        models.check_descriptor(artifact.metadata.descriptor_sha256)
        extractor = models.extractor(artifact.metadata.features)
        return OpenMap(
            artifact=artifact,
            index=index,
            retrieval=Retrieval(artifact, index),
            surroundings=MapSurroundings(artifact),
            descriptor=models.global_descriptor,
            extractor=extractor,
            faint_extractor=extractor.for_faint_images(),
            second_look=None if artifact.second is None else SecondLook(models),
        )

    def similar(self, rgb: Rgb, count: int, allowed: NDArray[np.int64] | None = None) -> list[int]:
        """Return the `count` keyframes, of the allowed ones, that look most like an image (height, width, 3)."""
        return self.retrieval.similar(self.descriptor.describe(rgb), count, 0, allowed)
