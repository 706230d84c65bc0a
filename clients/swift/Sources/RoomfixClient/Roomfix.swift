import Foundation
#if canImport(FoundationNetworking)
import FoundationNetworking
#endif

/// Axes of gravity and poses, in request and answer.
public enum Axes: String {
    case opencv, arkit, arcore, webxr, unity, unreal, ros
}

/// What is known of a picture.
public struct Hints {
    public var venue: String?
    public var floor: String?
    /// fx, fy, cx, cy in pixels of the picture as it is sent.
    public var camera: [Double]?
    /// Direction of down in the camera's axes.
    public var gravity: Position?
    public var axes: Axes = .arkit
    /// The camera's pose in the app's own session when the picture was taken.
    public var devicePose: Pose?

    public init() {}

    func fields() throws -> [(String, String)] {
        var fields = [("axes", axes.rawValue)]
        if let venue { fields.append(("venue", venue)) }
        if let floor { fields.append(("floor", floor)) }
        if let camera { fields.append(("camera", camera.map { "\($0)" }.joined(separator: ","))) }
        if let gravity { fields.append(("gravity", "\(gravity.x),\(gravity.y),\(gravity.z)")) }
        if let devicePose {
            let json = try JSONEncoder().encode(devicePose)
            fields.append(("device_pose", String(decoding: json, as: UTF8.self)))
        }
        return fields
    }
}

/// A server at an address, called with a token.
public struct Roomfix {
    private let locateURL: URL
    private let token: String

    /// `url` is the server's address without a slash at its end.
    public init(url: URL, token: String) {
        locateURL = URL(string: "\(url.absoluteString)/locate")!
        self.token = token
    }

    /// Locate a JPEG picture; throws `RoomfixError` for what the server refuses.
    public func locate(_ jpeg: Data, _ hints: Hints) async throws -> LocateResult {
        let boundary = UUID().uuidString
        var body = Data()
        for (name, value) in try hints.fields() {
            body.append(part(boundary, "name=\"\(name)\"\r\n"))
            body.append(Data("\(value)\r\n".utf8))
        }
        body.append(part(boundary, "name=\"image\"; filename=\"frame.jpg\"\r\nContent-Type: image/jpeg\r\n"))
        body.append(jpeg)
        body.append(Data("\r\n--\(boundary)--\r\n".utf8))
        var request = URLRequest(url: locateURL)
        request.httpMethod = "POST"
        request.setValue("Bearer \(token)", forHTTPHeaderField: "Authorization")
        request.setValue("multipart/form-data; boundary=\(boundary)", forHTTPHeaderField: "Content-Type")
        let (data, response) = try await URLSession.shared.upload(for: request, from: body)
        let status = (response as? HTTPURLResponse)?.statusCode ?? 0
        guard status == 200 else {
            let sent = try? JSONDecoder().decode(RoomfixError.self, from: data)
            throw sent ?? RoomfixError(status: status, code: "http_error", detail: "The server answered with status \(status).")
        }
        return try JSONDecoder().decode(LocateResult.self, from: data)
    }

    private func part(_ boundary: String, _ rest: String) -> Data {
        Data("--\(boundary)\r\nContent-Disposition: form-data; \(rest)\r\n".utf8)
    }
}
