"""What every node needs: parameters, messages, diagnostics, peers, and how its process starts and ends."""
