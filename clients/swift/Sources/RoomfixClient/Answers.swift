// What the server answers; `CodingKeys` hold the names in the JSON.

/// A point in metres.
public struct Position: Codable {
    public let x, y, z: Double

    public init(x: Double, y: Double, z: Double) {
        (self.x, self.y, self.z) = (x, y, z)
    }
}

/// A unit quaternion, scalar last.
public struct Quaternion: Codable {
    public let x, y, z, w: Double

    public init(x: Double, y: Double, z: Double, w: Double) {
        (self.x, self.y, self.z, self.w) = (x, y, z, w)
    }
}

/// A pose; that of an answer is world_from_camera.
public struct Pose: Codable {
    public let position: Position
    public let quaternion: Quaternion

    public init(position: Position, quaternion: Quaternion) {
        (self.position, self.quaternion) = (position, quaternion)
    }
}

/// A point on the floor plan: metres, and degrees counter-clockwise from plan x.
public struct Plan: Decodable {
    public let x, y, headingDeg: Double
    public let area, nearestLandmark: String?

    enum CodingKeys: String, CodingKey {
        case x = "x"
        case y = "y"
        case headingDeg = "heading_deg"
        case area = "area"
        case nearestLandmark = "nearest_landmark"
    }
}

/// One sigma.
public struct Accuracy: Decodable {
    public let positionM, orientationDeg: Double

    enum CodingKeys: String, CodingKey {
        case positionM = "position_m"
        case orientationDeg = "orientation_deg"
    }
}

/// Where the camera is, or the reason why that can't be said.
public struct LocateResult: Decodable {
    public let located: Bool
    public let reason, floor: String?
    public let pose: Pose?
    public let plan: Plan?
    public let accuracy: Accuracy?
    public let confidence: Double
    public let sessionFromWorld: Pose?
    public let hints: [String]

    enum CodingKeys: String, CodingKey {
        case located = "located"
        case reason = "reason"
        case floor = "floor"
        case pose = "pose"
        case plan = "plan"
        case accuracy = "accuracy"
        case confidence = "confidence"
        case sessionFromWorld = "session_from_world"
        case hints = "hints"
    }
}

/// What the server refused: its status, a stable code, and a sentence that says what to change.
public struct RoomfixError: Error, Decodable {
    public let status: Int
    public let code, detail: String

    enum CodingKeys: String, CodingKey {
        case status = "status"
        case code = "code"
        case detail = "detail"
    }
}
