"""Several frames in one query, compared with single frames."""
