"""Processes of a real flight: started, watched, ended, started again."""
