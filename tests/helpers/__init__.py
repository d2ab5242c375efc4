"""What several test modules share: small environments, a learner written from the paper, recording callbacks."""
