"""Pictures without camera poses: a video, a folder of photos, or the frames of a scan whose poses are not used."""
