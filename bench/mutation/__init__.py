"""Mutation testing: small changes to the code that refuses wrong answers, each of which some test must notice."""
