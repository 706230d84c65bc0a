"""What a scan holds and what a build would do with it, before anything is built."""
