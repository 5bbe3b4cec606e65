"""A mission as data: tables of TOML, checked; ``packaged/`` holds the scenarios that come with heft."""
