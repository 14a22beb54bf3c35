"""Published experiments repeated: on the printed data, and in a simulated world that is none of ours (`worlds`)."""
