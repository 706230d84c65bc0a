package roomfix

import org.json.JSONArray
import org.json.JSONObject

/** A point in metres. */
data class Position(val x: Double, val y: Double, val z: Double) {
    fun toJson(): JSONObject = JSONObject().put("x", x).put("y", y).put("z", z)
}

/** A unit quaternion, scalar last. */
data class Quaternion(val x: Double, val y: Double, val z: Double, val w: Double) {
    fun toJson(): JSONObject = JSONObject().put("x", x).put("y", y).put("z", z).put("w", w)
}

/** A pose; that of an answer is world_from_camera. */
data class Pose(val position: Position, val quaternion: Quaternion) {
    fun toJson(): JSONObject =
        JSONObject().put("position", position.toJson()).put("quaternion", quaternion.toJson())
}

/** A point on the floor plan: metres, and degrees counter-clockwise from plan x. */
data class Plan(
    val x: Double,
    val y: Double,
    val headingDeg: Double,
    val area: String?,
    val nearestLandmark: String?
)

/** Where the camera is, or the reason why that can't be said; `accuracyM` is one sigma of the position. */
data class LocateResult(
    val located: Boolean,
    val reason: String?,
    val floor: String?,
    val pose: Pose?,
    val plan: Plan?,
    val accuracyM: Double?,
    val confidence: Double,
    val sessionFromWorld: Pose?,
    val hints: List<String>
)

/** What the server refused: its status, a stable code, and a sentence that says what to change. */
class RoomfixException(val status: Int, val code: String, detail: String) : Exception(detail)

internal fun locateResultOf(json: JSONObject) = LocateResult(
    located = json.getBoolean("located"),
    reason = json.text("reason"),
    floor = json.text("floor"),
    pose = json.optJSONObject("pose")?.let(::poseOf),
    plan = json.optJSONObject("plan")?.let(::planOf),
    accuracyM = json.optJSONObject("accuracy")?.getDouble("position_m"),
    confidence = json.getDouble("confidence"),
    sessionFromWorld = json.optJSONObject("session_from_world")?.let(::poseOf),
    hints = json.getJSONArray("hints").texts()
)

private fun poseOf(json: JSONObject): Pose {
    val p = json.getJSONObject("position")
    val q = json.getJSONObject("quaternion")
    return Pose(
        Position(p.getDouble("x"), p.getDouble("y"), p.getDouble("z")),
        Quaternion(q.getDouble("x"), q.getDouble("y"), q.getDouble("z"), q.getDouble("w"))
    )
}

private fun planOf(json: JSONObject) = Plan(
    json.getDouble("x"),
    json.getDouble("y"),
    json.getDouble("heading_deg"),
    json.text("area"),
    json.text("nearest_landmark")
)

private fun JSONObject.text(name: String): String? = if (isNull(name)) null else getString(name)

private fun JSONArray.texts(): List<String> = List(length()) { getString(it) }
