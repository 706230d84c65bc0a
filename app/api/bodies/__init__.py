"""Bodies of answers that services return as plain values; each model describes one of them."""
