"""The ONNX models that ship with the application; each has a model card of the same name."""
