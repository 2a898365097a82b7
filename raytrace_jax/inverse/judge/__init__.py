"""The judgement of an answer: its error bars, what it rests on, and whether the model is right."""
