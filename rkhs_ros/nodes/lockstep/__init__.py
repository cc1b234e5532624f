"""The nodes of training in simulation, for which each message is the clock: learner, policy and their links."""
