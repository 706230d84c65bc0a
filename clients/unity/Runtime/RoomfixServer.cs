using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using UnityEngine;
using UnityEngine.Networking;

namespace Roomfix
{
    /// <summary>What is known of a picture.</summary>
    public class Hints
    {
        public string Venue, Floor;

        /// <summary>fx, fy, cx, cy in pixels of the picture as it is sent, from its upper left corner.</summary>
        public float[] Camera;

        /// <summary>Direction of down in the camera's axes.</summary>
        public Vector3? Gravity;

        public string Axes = "unity";

        /// <summary>The camera's pose in the app's own session when the picture was taken.</summary>
        public RoomfixPose? DevicePose;

        internal List<IMultipartFormSection> Fields()
        {
            var fields = new List<IMultipartFormSection> { new MultipartFormDataSection("axes", Axes) };
            if (Venue != null) fields.Add(new MultipartFormDataSection("venue", Venue));
            if (Floor != null) fields.Add(new MultipartFormDataSection("floor", Floor));
            if (Camera != null) fields.Add(new MultipartFormDataSection("camera", Joined(Camera)));
            if (Gravity != null)
            {
                var down = Gravity.Value;
                fields.Add(new MultipartFormDataSection("gravity", Joined(down.x, down.y, down.z)));
            }
            if (DevicePose != null)
            {
                fields.Add(new MultipartFormDataSection("device_pose", JsonUtility.ToJson(DevicePose.Value)));
            }
            return fields;
        }

        private static string Joined(params float[] values)
        {
            var texts = new string[values.Length];
            for (var k = 0; k < values.Length; k++) texts[k] = values[k].ToString("R", CultureInfo.InvariantCulture);
            return string.Join(",", texts);
        }
    }

    /// <summary>A server at an address, called with a token.</summary>
    public class RoomfixServer
    {
        private readonly string url, token;

        public RoomfixServer(string url, string token)
        {
            this.url = url.TrimEnd('/');
            this.token = token;
        }

        /// <summary>Locate a JPEG picture; start it as a coroutine. Without a connection `failed` gets status 0.</summary>
        public IEnumerator Locate(
            byte[] jpeg, Hints hints, Action<LocateResult> done, Action<RoomfixException> failed)
        {
            var form = hints.Fields();
            form.Add(new MultipartFormFileSection("image", jpeg, "frame.jpg", "image/jpeg"));
            using (var request = UnityWebRequest.Post(url + "/locate", form))
            {
                request.SetRequestHeader("Authorization", "Bearer " + token);
                yield return request.SendWebRequest();
                if (request.responseCode == 200) done(JsonUtility.FromJson<LocateResult>(request.downloadHandler.text));
                else failed(new RoomfixException(ProblemOf(request)));
            }
        }

        private static Problem ProblemOf(UnityWebRequest request)
        {
            try
            {
                var problem = JsonUtility.FromJson<Problem>(request.downloadHandler.text);
                if (problem != null && !string.IsNullOrEmpty(problem.code)) return problem;
            }
            catch (ArgumentException)
            {
                // A proxy in between answers in its own words.
            }
            var detail = request.error ?? "The server answered with status " + request.responseCode + ".";
            return new Problem { status = (int)request.responseCode, code = "http_error", detail = detail };
        }
    }
}
