package android.media

import java.nio.ByteBuffer

/** A picture of the format YUV_420_888. */
class Image(val width: Int, val height: Int, val planes: Array<Plane>) : AutoCloseable {
    class Plane(val buffer: ByteBuffer, val rowStride: Int, val pixelStride: Int)

    override fun close() {}
}
