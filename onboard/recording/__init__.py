"""The log: rows to MCAP and back.

Messages are the rows' own bytes behind a CDR header, schemas are ``ros2msg`` text generated from the dtype, and the
definitions of its channels stand at the head of every chunk: whatever survives of a file can be read, by us and by
stock tools. Nothing here reads a clock.
"""
