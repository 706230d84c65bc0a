package roomfix

import java.io.ByteArrayOutputStream
import java.net.HttpURLConnection
import java.net.URL
import java.util.UUID
import org.json.JSONException
import org.json.JSONObject

/**
 * What is known of a picture: `camera` is fx, fy, cx, cy in pixels of the picture as it is sent, `gravity` the direction of
 * down in the camera's axes, `devicePose` the camera's pose in the app's own session when the picture was taken.
 */
data class Hints(
    val venue: String? = null,
    val floor: String? = null,
    val camera: List<Double>? = null,
    val gravity: Position? = null,
    val axes: String = "arcore",
    val devicePose: Pose? = null
) {
    internal fun fields(): Map<String, String> {
        val fields = mutableMapOf("axes" to axes)
        venue?.let { fields["venue"] = it }
        floor?.let { fields["floor"] = it }
        camera?.let { fields["camera"] = it.joinToString(",") }
        gravity?.let { fields["gravity"] = "${it.x},${it.y},${it.z}" }
        devicePose?.let { fields["device_pose"] = it.toJson().toString() }
        return fields
    }
}

/** A server at an address, called with a token. Calls block: make them on a thread of your own. */
class Roomfix(url: String, private val token: String) {
    private val url = url.trimEnd('/')

    /** Locate a JPEG picture; throws [RoomfixException] for what the server refuses. */
    fun locate(jpeg: ByteArray, hints: Hints): LocateResult {
        val boundary = UUID.randomUUID().toString()
        val connection = URL("$url/locate").openConnection() as HttpURLConnection
        try {
            connection.requestMethod = "POST"
            connection.doOutput = true
            connection.setRequestProperty("Authorization", "Bearer $token")
            connection.setRequestProperty("Content-Type", "multipart/form-data; boundary=$boundary")
            connection.outputStream.use { it.write(body(boundary, jpeg, hints)) }
            val status = connection.responseCode
            val stream = if (status == 200) connection.inputStream else connection.errorStream
            val text = stream?.use { it.readBytes().toString(Charsets.UTF_8) } ?: ""
            if (status != 200) throw errorOf(status, text)
            return locateResultOf(JSONObject(text))
        } finally {
            connection.disconnect()
        }
    }

    private fun body(boundary: String, jpeg: ByteArray, hints: Hints): ByteArray {
        val bytes = ByteArrayOutputStream()
        for ((name, value) in hints.fields()) {
            bytes.write(part(boundary, "name=\"$name\"\r\n\r\n$value\r\n"))
        }
        bytes.write(part(boundary, "name=\"image\"; filename=\"frame.jpg\"\r\nContent-Type: image/jpeg\r\n\r\n"))
        bytes.write(jpeg)
        bytes.write("\r\n--$boundary--\r\n".toByteArray())
        return bytes.toByteArray()
    }

    private fun part(boundary: String, rest: String): ByteArray =
        "--$boundary\r\nContent-Disposition: form-data; $rest".toByteArray()

    private fun errorOf(status: Int, text: String): RoomfixException =
        try {
            val problem = JSONObject(text)
            RoomfixException(problem.getInt("status"), problem.getString("code"), problem.getString("detail"))
        } catch (error: JSONException) {
            RoomfixException(status, "http_error", "The server answered with status $status.")
        }
}
