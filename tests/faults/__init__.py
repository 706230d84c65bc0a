"""Faults on purpose: kills at random, changed bytes, a full disk, a disk that can't be written."""
