"""Campaigns: a plan of flights or logs, flown by Dask's workers, one result each, and what all of them say."""
