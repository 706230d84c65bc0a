/** The parts of Android that the Kotlin sample uses: a picture in planes, and its JPEG. */
package android.graphics

import java.awt.image.BufferedImage
import java.io.OutputStream
import javax.imageio.ImageIO

object ImageFormat {
    const val NV21 = 17
}

class Rect(val left: Int, val top: Int, val right: Int, val bottom: Int)

/** All of Y, then V and U in turn at half the size. */
class YuvImage(private val bytes: ByteArray, format: Int, private val width: Int, private val height: Int, strides: IntArray?) {
    init {
        require(format == ImageFormat.NV21 && strides == null && bytes.size == width * height * 3 / 2)
    }

    fun compressToJpeg(part: Rect, quality: Int, stream: OutputStream): Boolean {
        require(part.right - part.left == width && part.bottom - part.top == height && quality in 1..100)
        val picture = BufferedImage(width, height, BufferedImage.TYPE_INT_RGB)
        for (row in 0 until height) {
            for (column in 0 until width) picture.setRGB(column, row, rgb(row, column))
        }
        return ImageIO.write(picture, "jpg", stream)
    }

    /** ITU-R BT.601 with the range that OpenCV writes: Y from 16 to 235. */
    private fun rgb(row: Int, column: Int): Int {
        val chroma = width * height + row / 2 * width + column / 2 * 2
        val y = 1.164 * (value(row * width + column) - 16)
        val v = value(chroma) - 128.0
        val u = value(chroma + 1) - 128.0
        val channels = listOf(y + 1.596 * v, y - 0.813 * v - 0.391 * u, y + 2.018 * u)
        return channels.fold(0) { color, channel -> color shl 8 or Math.min(255, Math.max(0, channel.toInt())) }
    }

    private fun value(at: Int): Int = bytes[at].toInt() and 255
}
