"""From a scan to a map: keyframes, points, the sensor and its lens, registration, calibration, the self-check."""
