"""Database, blobs and map artefacts: explicit queries per aggregate."""
