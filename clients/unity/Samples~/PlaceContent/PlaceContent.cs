using System;
using System.Collections;
using Unity.Collections;
using UnityEngine;
using UnityEngine.XR.ARFoundation;
using UnityEngine.XR.ARSubsystems;

namespace Roomfix.Samples
{
    /// <summary>
    /// Gets a frame of AR Foundation's camera, locates it, and moves `root` so that its children stand at their places in
    /// the venue's world: a place (x, y, z) of the map is localPosition (x, z, y) below the root.
    /// </summary>
    public class PlaceContent : MonoBehaviour
    {
        public ARCameraManager cameraManager;
        public Transform root;
        public string url, token, venue;
        public float everySeconds = 5;

        private IEnumerator Start()
        {
            var server = new RoomfixServer(url, token);
            while (true)
            {
                byte[] jpeg;
                Hints hints;
                if (TryShoot(out jpeg, out hints)) yield return server.Locate(jpeg, hints, Place, Report);
                yield return new WaitForSeconds(everySeconds);
            }
        }

        private bool TryShoot(out byte[] jpeg, out Hints hints)
        {
            jpeg = null;
            hints = null;
            XRCpuImage image;
            XRCameraIntrinsics k;
            if (!cameraManager.TryGetIntrinsics(out k) || !cameraManager.TryAcquireLatestCpuImage(out image)) return false;
            using (image) jpeg = Encoded(image);
            var device = cameraManager.transform;
            var rotation = device.localRotation * SensorInScreen(Screen.orientation);
            hints = new Hints
            {
                Venue = venue,
                Camera = new[] { k.focalLength.x, k.focalLength.y, k.principalPoint.x, k.principalPoint.y },
                Gravity = Quaternion.Inverse(rotation) * Vector3.down,
                DevicePose = new RoomfixPose
                {
                    position = Position.Of(device.localPosition),
                    quaternion = Rotation.Of(rotation),
                },
            };
            return true;
        }

        /// <summary>
        /// How the sensor, whose picture is sent as it is, is turned in the camera that Unity shows: Unity's camera turns
        /// with the screen, the picture and its intrinsics don't.
        /// </summary>
        private static Quaternion SensorInScreen(ScreenOrientation orientation)
        {
            switch (orientation)
            {
                case ScreenOrientation.Portrait: return Quaternion.Euler(0, 0, -90);
                case ScreenOrientation.PortraitUpsideDown: return Quaternion.Euler(0, 0, 90);
                case ScreenOrientation.LandscapeRight: return Quaternion.Euler(0, 0, 180);
                default: return Quaternion.identity;
            }
        }

        /// <summary>The picture as JPEG; rows of a texture go from below, so that it is mirrored for the file.</summary>
        private static byte[] Encoded(XRCpuImage image)
        {
            var wanted = new XRCpuImage.ConversionParams(image, TextureFormat.RGBA32, XRCpuImage.Transformation.MirrorX);
            var pixels = new NativeArray<byte>(image.GetConvertedDataSize(wanted), Allocator.Temp);
            var texture = new Texture2D(image.width, image.height, TextureFormat.RGBA32, false);
            try
            {
                image.Convert(wanted, pixels);
                texture.LoadRawTextureData(pixels);
                texture.Apply();
                return texture.EncodeToJPG(90);
            }
            finally
            {
                pixels.Dispose();
                Destroy(texture);
            }
        }

        private void Place(LocateResult result)
        {
            if (!result.session_from_world.IsKnown)
            {
                Debug.Log("Not located (" + result.reason + "): " + string.Join(", ", result.hints));
                return;
            }
            root.localPosition = result.session_from_world.position.ToVector3();
            root.localRotation = result.session_from_world.quaternion.ToQuaternion();
        }

        private void Report(RoomfixException error)
        {
            Debug.LogWarning(error.Code + ": " + error.Message);
        }
    }
}
