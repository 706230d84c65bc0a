"""What services stand on: database, blobs, models, the executor and the scratch folder."""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import faiss
from threadpoolctl import threadpool_limits

from app.engine.maps.vision_models import VisionModels
from app.settings import Settings
from app.storage.blobs import BlobStore
from app.storage.db import Database


@dataclass(frozen=True, slots=True, kw_only=True)
class Resources:
    """Opened once per process by whoever wires it: the server, the build worker, the command line."""

    settings: Settings
    database: Database
    blobs: BlobStore
    models: VisionModels
    executor: Executor
    scratch_dir: Path

    @staticmethod
    def open(settings: Settings, *, is_patient: bool = False) -> Resources:
        """Open everything, the database brought to its newest form; `is_patient` as in `Database`."""
        cap_threads()
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        settings.scratch_dir.mkdir(parents=True, exist_ok=True)
        database = Database(settings.resolved_database_url, is_patient=is_patient)
        database.migrate()
        return Resources(
            settings=settings,
            database=database,
            blobs=BlobStore.open(
                settings.blob_url, settings.data_dir, settings.cache_dir, settings.blob_cache_bytes
            ),
            models=open_models(settings),
            executor=ThreadPoolExecutor(settings.workers, thread_name_prefix="compute"),
            scratch_dir=settings.scratch_dir,
        )

    def close(self) -> None:
        """Stop the executor and close the database."""
        self.executor.shutdown(wait=True, cancel_futures=True)
        self.database.close()


def open_models(settings: Settings) -> VisionModels:
    """Return the models that the settings name."""
    size = settings.descriptor_width, settings.descriptor_height
    return VisionModels(settings.descriptor_model, size, face_model=settings.face_model)


def cap_threads() -> None:
    """Let OpenCV, FAISS and BLAS use one thread a call: the executor's threads are what keeps the cores busy."""
    cv2.setNumThreads(1)
    faiss.omp_set_num_threads(1)
    threadpool_limits(1)
