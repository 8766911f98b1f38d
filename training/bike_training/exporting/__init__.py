"""Policies in forms that other machines run: ONNX, and one C header."""
