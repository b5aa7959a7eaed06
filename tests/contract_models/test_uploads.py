"""The uploads that a task names."""

from planners.contract.shapes import named_uploads


def test_uploads_are_found_wherever_a_task_names_meshes() -> None:
    def mesh(upload: str) -> dict[str, object]:
        return {"type": "mesh", "asset": None, "upload": upload, "scale": 1.0}

    task = {
        "objects": [
            {"shape": mesh("a")},
            {"shape": mesh("b")},
            {"shape": {"type": "mesh", "asset": "can", "upload": None}},
        ],
        "tool": {"shapes": [{"shape": mesh("c")}, {"shape": {"type": "box", "size": [1, 1, 1]}}]},
        "obstacles": [{"name": "upload", "shape": mesh("a")}],
        "external_id": "mesh",
    }
    assert named_uploads(task) == {"a", "b", "c"}
    assert named_uploads({"objects": []}) == frozenset()
