"""Why tests take as long as they do: the start of a test's name -> the reason; the longest that fits counts."""

from __future__ import annotations

MAP_OVER_HTTP = "builds a map from a rendered room through the real server and worker"
MAP_IN_PROCESS = "builds a map from a rendered room"
RENDERED_BUILDING = "renders pictures of the demonstration building"

REASONS = {
    "tests/api/": MAP_OVER_HTTP,
    "tests/api/test_anchor": "describes monitoring frames and phone pictures and estimates relative poses",
    "tests/api/test_anchor_sessions": "tracks a phone frame by frame from a monitoring camera's view",
    "tests/api/test_fisheye_anchor": "describes fisheye frames at 1280 px and estimates relative poses",
    "tests/api/test_calibrate": "matches hundreds of pairs of frames",
    "tests/api/test_session": "builds a map and tracks a video frame by frame through the real server",
    "tests/api/test_plan_files": "draws plans, hostile ones too, in processes of their own",
    "tests/cases/": "sends a whole scan to a real server and waits for its map",
    "tests/fuzz/": "makes hundreds of requests to a live server, some for each call that OpenAPI describes",
    "tests/test_logs": "starts a server as a process of its own",
    "tests/test_values": "parses all modules and looks at every call in them",
    "tests/clients/": "starts a server with a map, and runs the client against it",
    "tests/faults/": "starts servers and workers as processes of their own, and kills them",
    "tests/geometry/": "repeats an estimate over many random scenes",
    "tests/importers/": "reads damaged archives of every kind",
    "tests/storage/": "waits for locks of real databases",
    "tests/commands/": "runs a command against a server of its own",
    "tests/engine/anchors/": "describes monitoring frames and estimates relative poses",
    "tests/engine/mapping/": MAP_IN_PROCESS,
    "tests/engine/mapping/test_calibrate": "matches hundreds of pairs of frames",
    "tests/engine/mapping/structure/": "estimates the poses of photos of a rendered room",
    "tests/engine/maps/": MAP_IN_PROCESS,
    "tests/engine/query/": "builds maps and locates pictures in them, the refused ones by all second searches",
    "tests/engine/tracking/": "builds a map and tracks a video frame by frame",
    "tests/jobs/": "starts servers and workers as processes of their own, and kills them",
    "tests/services/": MAP_IN_PROCESS,
    "tests/services/builds/": "builds the one map that all of these tests share",
    "tests/services/test_build_from_photos": "estimates the poses of photos of a rendered room and builds their map",
    "tests/vision/": "describes pictures with the shipped models",
    "tests/web/": "drives a real browser against a live server",
    "bench/tests/commands/": "runs a measuring command on a small scan, maps included",
    "bench/tests/evaluation/": "runs a measuring command on a small scan, maps included",
    "bench/tests/evaluation/test_simulation": "walks through the demonstration building, rendering each frame",
    "bench/tests/formats/": "writes a scan in every format and reads it again",
    "bench/tests/large_maps/": "tiles a map to many keyframes",
    "bench/tests/mutation/": "runs the tests of a module against changes to it",
    "bench/tests/unposed/": "writes and reads a video",
    "bench/tests/pages/": "measures a page in a real browser against a live server",
    "bench/tests/rooms/": "runs a measuring command on a small scan, maps included",
    "bench/tests/venue/": RENDERED_BUILDING,
    "bench/tests/venue/test_imdf": "compares hundreds of routes before and after an export",
    "bench/tests/venue/test_trajectory": "plans the path of a scan of 2400 frames through both floors",
}
