"""Model-based training: the algorithm trains the policy in a learnt model between real iterations."""
