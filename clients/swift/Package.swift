// swift-tools-version:5.7
import PackageDescription

let package = Package(
    name: "RoomfixClient",
    platforms: [.iOS(.v15), .macOS(.v12)],
    products: [
        .library(name: "RoomfixClient", targets: ["RoomfixClient"]),
        .library(name: "RoomfixARKit", targets: ["RoomfixARKit"]),
    ],
    targets: [
        .target(name: "RoomfixClient"),
        .target(name: "RoomfixARKit", dependencies: ["RoomfixClient"]),
    ]
)
