// Locates a picture by the Swift client: ADDRESS TOKEN PICTURE fx,fy,cx,cy x,y,z,qx,qy,qz,qw.
import Foundation
import RoomfixClient

@main
struct Locate {
    static func numbers(_ text: String) -> [Double] {
        text.split(separator: ",").compactMap { Double($0) }
    }

    static func main() async throws {
        let given = CommandLine.arguments
        let server = Roomfix(url: URL(string: given[1])!, token: given[2])
        var hints = Hints()
        hints.venue = "museum"
        hints.camera = numbers(given[4])
        let pose = numbers(given[5])
        hints.devicePose = Pose(
            position: Position(x: pose[0], y: pose[1], z: pose[2]),
            quaternion: Quaternion(x: pose[3], y: pose[4], z: pose[5], w: pose[6])
        )
        do {
            let picture = try Data(contentsOf: URL(fileURLWithPath: given[3]))
            let result = try await server.locate(picture, hints)
            print(result.located, result.floor ?? "-")
            if let pose = result.sessionFromWorld {
                let p = pose.position, q = pose.quaternion
                print(p.x, p.y, p.z, q.x, q.y, q.z, q.w)
            }
        } catch let refused as RoomfixError {
            print(refused.status, refused.code)
        }
    }
}
