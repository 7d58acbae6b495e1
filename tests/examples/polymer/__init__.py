"""Tests of the flow wing."""
