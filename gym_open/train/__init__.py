"""Stage 3: encoders are learned from a release, policies are fine-tuned from an encoder."""
