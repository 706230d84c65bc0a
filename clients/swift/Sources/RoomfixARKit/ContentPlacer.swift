#if canImport(ARKit) && os(iOS)
import ARKit
import CoreImage
import RoomfixClient

/// Gets a frame of an ARSession, locates it, and moves a root node so that its children stand at their places in the
/// venue's world: a place (x, y, z) of the map is `SCNVector3(x, z, -y)` below the root.
public final class ContentPlacer {
    public let root = SCNNode()
    private let server: Roomfix
    private let venue: String
    private let images = CIContext()

    public init(server: Roomfix, venue: String) {
        (self.server, self.venue) = (server, venue)
    }

    /// Locate the newest frame of a session; the answer says whether the root was moved.
    @MainActor
    public func place(in session: ARSession) async throws -> LocateResult? {
        guard let frame = session.currentFrame, let jpeg = jpeg(of: frame) else { return nil }
        let result = try await server.locate(jpeg, hints(of: frame.camera))
        if let sessionFromWorld = result.sessionFromWorld {
            root.simdTransform = transform(of: sessionFromWorld)
        }
        return result
    }

    /// The sensor's picture as it is, not turned: intrinsics and `camera.transform` are for that.
    private func jpeg(of frame: ARFrame) -> Data? {
        let image = CIImage(cvPixelBuffer: frame.capturedImage)
        return images.jpegRepresentation(of: image, colorSpace: CGColorSpaceCreateDeviceRGB())
    }

    private func hints(of camera: ARCamera) -> Hints {
        let k = camera.intrinsics, t = camera.transform
        var hints = Hints()
        hints.venue = venue
        hints.axes = .arkit
        hints.camera = [k[0][0], k[1][1], k[2][0], k[2][1]].map(Double.init)
        // Down is (0, -1, 0) in the session; its coordinates in the camera are minus the y of each camera axis.
        hints.gravity = Position(x: -Double(t[0].y), y: -Double(t[1].y), z: -Double(t[2].y))
        let q = simd_quatf(t).vector, p = t[3]
        hints.devicePose = Pose(
            position: Position(x: Double(p.x), y: Double(p.y), z: Double(p.z)),
            quaternion: Quaternion(x: Double(q.x), y: Double(q.y), z: Double(q.z), w: Double(q.w))
        )
        return hints
    }

    private func transform(of pose: Pose) -> simd_float4x4 {
        let q = pose.quaternion, p = pose.position
        var matrix = simd_float4x4(simd_quatf(ix: Float(q.x), iy: Float(q.y), iz: Float(q.z), r: Float(q.w)))
        matrix.columns.3 = SIMD4<Float>(Float(p.x), Float(p.y), Float(p.z), 1)
        return matrix
    }
}
#endif
