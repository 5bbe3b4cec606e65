"""Writes and reads logs: rows to MCAP and back.

Messages are the rows' own bytes behind a CDR header, schemas are ``ros2msg`` text generated from the dtype, and the
definitions of its channels are at the head of every chunk, so that every intact part of a file is readable, by heft and
by stock tools. Nothing here reads a clock.
"""
