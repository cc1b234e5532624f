"""What the learner acts on: tasks as Gymnasium environments, and the node that puts them behind topics."""
