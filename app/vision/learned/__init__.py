"""Learned local features and their matcher, by ONNX Runtime."""
