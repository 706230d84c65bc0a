"""ONNX Runtime sessions with a limited number of threads, and the identity of a model file."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

import onnxruntime as ort


def open_session(path: Path, threads: int = 1) -> ort.InferenceSession:
    """Open an ONNX model on the CPU with at most `threads` threads for one call."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Threads that wait actively between calls would occupy the core that matching needs.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    return ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


@lru_cache(maxsize=16)
def model_sha256(path: Path) -> str:
    """Return the SHA-256 of a model file. A map records it, so that descriptors of two models are never mixed."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
