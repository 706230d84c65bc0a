/**
 * Runs the Kotlin sample: ADDRESS TOKEN PICTURE WIDTH HEIGHT fx,fy,cx,cy x,y,z,qx,qy,qz,qw. PICTURE holds Y, then U, then V;
 * the planes are given to the sample as phones give them: rows with padding, U and V in turn in one buffer.
 */
import android.media.Image
import com.google.ar.core.Camera
import com.google.ar.core.CameraIntrinsics
import com.google.ar.core.Frame
import com.google.ar.core.Pose
import java.io.File
import java.nio.ByteBuffer
import roomfix.ContentPlacer
import roomfix.Roomfix
import roomfix.RoomfixException

const val PADDING = 16

fun floats(text: String) = text.split(",").map { it.toFloat() }.toFloatArray()

fun image(bytes: ByteArray, width: Int, height: Int): Image {
    val stride = width + PADDING
    val bright = ByteArray(height * stride)
    for (row in 0 until height) System.arraycopy(bytes, row * width, bright, row * stride, width)
    val colors = ByteArray(height / 2 * stride)
    val quarter = width * height / 4
    for (k in 0 until quarter) {
        val at = k / (width / 2) * stride + k % (width / 2) * 2
        colors[at] = bytes[4 * quarter + k]
        colors[at + 1] = bytes[5 * quarter + k]
    }
    val u = ByteBuffer.wrap(colors)
    val v = ByteBuffer.wrap(colors, 1, colors.size - 1).slice()
    val planes = arrayOf(Image.Plane(ByteBuffer.wrap(bright), stride, 1), Image.Plane(u, stride, 2), Image.Plane(v, stride, 2))
    return Image(width, height, planes)
}

fun main(args: Array<String>) {
    val numbers = floats(args[5])
    val intrinsics = CameraIntrinsics(numbers.copyOfRange(0, 2), numbers.copyOfRange(2, 4))
    val pose = floats(args[6])
    val camera = Camera(Pose(pose.copyOfRange(0, 3), pose.copyOfRange(3, 7)), intrinsics)
    val picture = image(File(args[2]).readBytes(), args[3].toInt(), args[4].toInt())
    val placer = ContentPlacer(Roomfix(args[0], args[1]), "museum")
    try {
        val result = placer.locate(placer.shot(Frame(camera, picture)))
        println("${result.located} ${result.floor}")
        placer.sessionFromWorld?.let { println("${it.tx()} ${it.ty()} ${it.tz()} ${it.qx()} ${it.qy()} ${it.qz()} ${it.qw()}") }
    } catch (refused: RoomfixException) {
        println("${refused.status} ${refused.code}")
    }
}
