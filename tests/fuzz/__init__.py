"""Requests made from the OpenAPI document, valid and invalid ones, against a real server."""
