"""The rig: a simulated plant and the controller as two processes that exchange CAN frames."""
