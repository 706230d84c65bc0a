package roomfix

import android.graphics.ImageFormat
import android.graphics.Rect
import android.graphics.YuvImage
import android.media.Image
import com.google.ar.core.Frame
import com.google.ar.core.Pose as ArPose
import java.io.ByteArrayOutputStream

/**
 * Gets a frame of an ARCore session, locates it, and keeps `sessionFromWorld`: a place (x, y, z) of the map is
 * `sessionFromWorld.transformPoint(floatArrayOf(x, z, -y))` in the session, where content is drawn.
 */
class ContentPlacer(private val server: Roomfix, private val venue: String) {
    @Volatile
    var sessionFromWorld: ArPose? = null
        private set

    /** What [locate] needs of a frame; take it on the thread that draws, right after `session.update()`. */
    class Shot(val jpeg: ByteArray, val hints: Hints)

    /** The sensor's picture as it is, not turned: `imageIntrinsics` and `camera.pose` are for that. */
    fun shot(frame: Frame): Shot {
        val camera = frame.camera
        val k = camera.imageIntrinsics
        val jpeg = frame.acquireCameraImage().use(::jpegOf)
        // Down is (0, -1, 0) in the session.
        val down = camera.pose.inverse().rotateVector(floatArrayOf(0f, -1f, 0f)).map { it.toDouble() }
        val hints = Hints(
            venue = venue,
            camera = (k.focalLength + k.principalPoint).map { it.toDouble() },
            gravity = Position(down[0], down[1], down[2]),
            axes = "arcore",
            devicePose = poseOf(camera.pose)
        )
        return Shot(jpeg, hints)
    }

    /** Locate a shot, on a thread of your own; the answer says whether content was placed. */
    fun locate(shot: Shot): LocateResult {
        val result = server.locate(shot.jpeg, shot.hints)
        result.sessionFromWorld?.let { sessionFromWorld = arPoseOf(it) }
        return result
    }

    private fun poseOf(pose: ArPose) = Pose(
        Position(pose.tx().toDouble(), pose.ty().toDouble(), pose.tz().toDouble()),
        Quaternion(pose.qx().toDouble(), pose.qy().toDouble(), pose.qz().toDouble(), pose.qw().toDouble())
    )

    private fun arPoseOf(pose: Pose): ArPose {
        val p = pose.position
        val q = pose.quaternion
        return ArPose(
            floatArrayOf(p.x.toFloat(), p.y.toFloat(), p.z.toFloat()),
            floatArrayOf(q.x.toFloat(), q.y.toFloat(), q.z.toFloat(), q.w.toFloat())
        )
    }

    private fun jpegOf(image: Image): ByteArray {
        val bytes = ByteArrayOutputStream()
        val picture = YuvImage(nv21Of(image), ImageFormat.NV21, image.width, image.height, null)
        picture.compressToJpeg(Rect(0, 0, image.width, image.height), 90, bytes)
        return bytes.toByteArray()
    }

    /** The bytes of a YUV_420_888 image as NV21: all of Y, then V and U in turn; rows may be padded. */
    private fun nv21Of(image: Image): ByteArray {
        val (width, height) = image.width to image.height
        val bytes = ByteArray(width * height * 3 / 2)
        val (y, u, v) = image.planes
        var at = 0
        for (row in 0 until height) {
            for (column in 0 until width) {
                bytes[at++] = y.buffer.get(row * y.rowStride + column * y.pixelStride)
            }
        }
        for (row in 0 until height / 2) {
            for (column in 0 until width / 2) {
                bytes[at++] = v.buffer.get(row * v.rowStride + column * v.pixelStride)
                bytes[at++] = u.buffer.get(row * u.rowStride + column * u.pixelStride)
            }
        }
        return bytes
    }
}
