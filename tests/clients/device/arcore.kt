/** The parts of ARCore that the Kotlin sample uses: a frame with a camera that stands at a pose. */
package com.google.ar.core

import android.media.Image

class Pose(private val translation: FloatArray, private val rotation: FloatArray) {
    fun tx() = translation[0]

    fun ty() = translation[1]

    fun tz() = translation[2]

    fun qx() = rotation[0]

    fun qy() = rotation[1]

    fun qz() = rotation[2]

    fun qw() = rotation[3]

    fun inverse(): Pose {
        val turn = Pose(FloatArray(3), floatArrayOf(-qx(), -qy(), -qz(), qw()))
        return Pose(turn.rotateVector(translation).map { -it }.toFloatArray(), turn.rotation)
    }

    /** v + 2 w (q x v) + 2 q x (q x v) */
    fun rotateVector(v: FloatArray): FloatArray {
        val once = cross(v)
        val twice = cross(once)
        return FloatArray(3) { v[it] + 2 * qw() * once[it] + 2 * twice[it] }
    }

    private fun cross(v: FloatArray) =
        floatArrayOf(qy() * v[2] - qz() * v[1], qz() * v[0] - qx() * v[2], qx() * v[1] - qy() * v[0])
}

class CameraIntrinsics(val focalLength: FloatArray, val principalPoint: FloatArray)

class Camera(val pose: Pose, val imageIntrinsics: CameraIntrinsics)

class Frame(val camera: Camera, private val image: Image) {
    fun acquireCameraImage() = image
}
