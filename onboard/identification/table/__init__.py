"""A base on an air-bearing table: its run is recorded on board and fitted in one batch afterwards."""
