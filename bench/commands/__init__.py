"""The commands of the bench, one a file; `roomfix` offers them where the checkout is."""

from __future__ import annotations

# Command -> the function that runs it, as `module:function`.
COMMANDS = {
    "demo": "bench.commands.demo:demo",
    "evaluate": "bench.commands.evaluate:evaluate",
    "benchmark": "bench.commands.evaluate:benchmark",
    "evaluate-rooms": "bench.rooms.evaluate_rooms:evaluate_rooms",
    "evaluate-demo": "bench.commands.evaluate_demo:evaluate_demo",
    "examine-mistakes": "bench.commands.examine_mistakes:examine_mistakes",
    "evaluate-formats": "bench.formats.command:evaluate_formats_command",
    "evaluate-unposed": "bench.unposed.command:evaluate_unposed_command",
    "evaluate-video": "bench.unposed.floor_video:evaluate_video",
    "evaluate-drift": "bench.drift.command:evaluate_drift",
    "evaluate-extend": "bench.commands.evaluate_extend:evaluate_extend",
    "evaluate-phones": "bench.commands.evaluate_phones:evaluate_phones",
    "evaluate-walk": "bench.commands.evaluate_walk:evaluate_walk",
    "evaluate-cameras": "bench.commands.evaluate_cameras:evaluate_cameras_command",
    "evaluate-anchors": "bench.commands.evaluate_anchors:evaluate_anchors",
    "reliability": "bench.commands.reliability:reliability",
    "fit-confidence": "bench.commands.fit_confidence:fit_confidence_command",
    "keyframes": "bench.commands.keyframes:keyframes",
    "plot-axes": "bench.axes.command:plot_axes",
    "plot-calibration": "bench.commands.plot_calibration:plot_calibration",
    "track": "bench.commands.track:track",
    "track-anchors": "bench.commands.track_anchors:track_anchors",
    "limits": "bench.commands.limits:limits",
    "simulate": "bench.commands.simulate:simulate",
    "simulate-figures": "bench.commands.simulate_figures:simulate_figures",
    "capacity": "bench.capacity.command:capacity",
    "trace-query": "bench.commands.trace_query:trace_query",
    "large-maps": "bench.large_maps.command:large_maps",
    "evaluate-phone-page": "bench.pages.command:evaluate_phone_page",
    "stream-bench": "bench.commands.stream_bench:stream_bench",
    "overload": "bench.overload.command:overload",
    "upload-bench": "bench.uploads.command:upload_bench",
}
