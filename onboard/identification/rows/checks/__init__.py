"""Agreement of rows and instruments with an estimate; suspects among them."""
