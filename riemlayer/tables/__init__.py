"""The paper's tables: every system on shapes that training never saw (Sec. 4, app. D to G)."""
