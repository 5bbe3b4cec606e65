"""CAN transports."""
