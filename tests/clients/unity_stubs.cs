// Stand-ins for the parts of Unity and AR Foundation that the client and its sample use, to compile against. They state
// signatures only.
using System;
using System.Collections;
using System.Collections.Generic;

namespace UnityEngine
{
    public class Object { public static void Destroy(Object target) { } }
    public class Component : Object { public Transform transform { get { return null; } } }
    public class MonoBehaviour : Component { public Coroutine StartCoroutine(IEnumerator routine) { return null; } }
    public class Coroutine { }
    public class WaitForSeconds { public WaitForSeconds(float seconds) { } }

    public class Transform : Component
    {
        public Vector3 localPosition { get; set; }
        public Quaternion localRotation { get; set; }
    }

    public struct Vector2 { public float x, y; }

    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 down { get { return new Vector3(0, -1, 0); } }
    }

    public struct Quaternion
    {
        public float x, y, z, w;
        public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
        public static Quaternion identity { get { return new Quaternion(0, 0, 0, 1); } }
        public static Quaternion Euler(float x, float y, float z) { return identity; }
        public static Quaternion Inverse(Quaternion rotation) { return rotation; }
        public static Quaternion operator *(Quaternion left, Quaternion right) { return left; }
        public static Vector3 operator *(Quaternion rotation, Vector3 point) { return point; }
    }

    public enum ScreenOrientation { Portrait, PortraitUpsideDown, LandscapeLeft, LandscapeRight }
    public static class Screen { public static ScreenOrientation orientation { get; set; } }
    public enum TextureFormat { RGBA32 }

    public class Texture2D : Object
    {
        public Texture2D(int width, int height, TextureFormat format, bool mipChain) { }
        public void LoadRawTextureData<T>(Unity.Collections.NativeArray<T> data) where T : struct { }
        public void Apply() { }
    }

    public static class ImageConversion { public static byte[] EncodeToJPG(this Texture2D texture, int quality) { return null; } }
    public static class Debug { public static void Log(object message) { } public static void LogWarning(object message) { } }

    public static class JsonUtility
    {
        public static string ToJson(object value) { return null; }
        public static T FromJson<T>(string text) { return default(T); }
    }
}

namespace UnityEngine.Networking
{
    public interface IMultipartFormSection { }
    public class MultipartFormDataSection : IMultipartFormSection { public MultipartFormDataSection(string name, string data) { } }

    public class MultipartFormFileSection : IMultipartFormSection
    {
        public MultipartFormFileSection(string name, byte[] data, string fileName, string contentType) { }
    }

    public class DownloadHandler { public string text { get { return null; } } }
    public class UnityWebRequestAsyncOperation { }

    public class UnityWebRequest : IDisposable
    {
        public static UnityWebRequest Post(string uri, List<IMultipartFormSection> sections) { return null; }
        public void SetRequestHeader(string name, string value) { }
        public UnityWebRequestAsyncOperation SendWebRequest() { return null; }
        public long responseCode { get { return 0; } }
        public string error { get { return null; } }
        public DownloadHandler downloadHandler { get { return null; } }
        public void Dispose() { }
    }
}

namespace Unity.Collections
{
    public enum Allocator { Temp }

    public struct NativeArray<T> : IDisposable where T : struct
    {
        public NativeArray(int length, Allocator allocator) { }
        public void Dispose() { }
        public static implicit operator NativeSlice<T>(NativeArray<T> array) { return new NativeSlice<T>(); }
    }

    public struct NativeSlice<T> where T : struct { }
}

namespace UnityEngine.XR.ARSubsystems
{
    public struct XRCameraIntrinsics
    {
        public Vector2 focalLength { get { return new Vector2(); } }
        public Vector2 principalPoint { get { return new Vector2(); } }
    }

    public struct XRCpuImage : IDisposable
    {
        [Flags] public enum Transformation { None = 0, MirrorX = 1, MirrorY = 2 }

        public struct ConversionParams
        {
            public ConversionParams(XRCpuImage image, TextureFormat format, Transformation transformation) { }
        }

        public int width { get { return 0; } }
        public int height { get { return 0; } }
        public int GetConvertedDataSize(ConversionParams wanted) { return 0; }
        public void Convert(ConversionParams wanted, Unity.Collections.NativeSlice<byte> buffer) { }
        public void Dispose() { }
    }
}

namespace UnityEngine.XR.ARFoundation
{
    public class ARCameraManager : MonoBehaviour
    {
        public bool TryGetIntrinsics(out ARSubsystems.XRCameraIntrinsics intrinsics)
        {
            intrinsics = new ARSubsystems.XRCameraIntrinsics();
            return true;
        }

        public bool TryAcquireLatestCpuImage(out ARSubsystems.XRCpuImage image)
        {
            image = new ARSubsystems.XRCpuImage();
            return true;
        }
    }
}
